/* A leg controller on the board: firmware_protocol.md over UART 0, with a simulated knee where bridge and sensors are
 * the next board's. Whoever builds a real one replaces read_sensors() and drive_bridge(), and keeps the rest. MIT. */
#include "../leg_core.h"
#include "board.h"

#define TELEMETRY_HZ 250u
#define INERTIA_MILLI 100   /* of the simulated knee [1e-3 kg m^2] */
#define STIFFNESS_MILLI 3000 /* gravity, for small angles [1e-3 N m/rad] */
#define DAMPING_MILLI 200    /* [1e-3 N m s/rad] */

static const leg_config CONFIG = {
    .telemetry_hz = TELEMETRY_HZ, .gear_ratio_milli = 50000, .torque_limit_unm = 2000000, .watchdog_limit_ms = 1000,
    .current_limit_ua = 30000000, .temperature_limit_cdegc = 9000, .undervoltage_mv = 18000, .overvoltage_mv = 30000,
    .speed_limit_uradps = 40000000, .speed_derate_uradps = 32000000,
    .position_min_urad = -2800000, .position_max_urad = 2800000, .position_derate_urad = 200000, .reaction = LEG_LIMP,
};

static leg_core core;
static volatile int32_t bridge_torque_unm; /* what the bridge is given */
static volatile int32_t impulse;           /* its sum since the last sample, of a few loops */
static volatile int32_t loops;
static volatile int32_t knee_urad, speed_uradps;
/* For a debugger, kept over a reset: the tick of the last current loop, of the last that drove and of the first. */
static volatile struct {
    uint32_t loop_us, driven_us, first_us;
} trace __attribute__((section(".noinit"), used));

/* 1 N m/A; a real board sets duty cycles here, and takes its gate's enable away where bridge is LEG_BRIDGE_OFF. */
static void drive_bridge(int32_t torque_unm, leg_bridge bridge)
{
    bridge_torque_unm = bridge == LEG_BRIDGE_OFF ? 0 : torque_unm;
}

static void swing_knee(void)
{
    int64_t torque = bridge_torque_unm;
    torque -= ((int64_t)STIFFNESS_MILLI * knee_urad + (int64_t)DAMPING_MILLI * speed_uradps) / 1000;
    speed_uradps += (int32_t)(torque * 1000 / (INERTIA_MILLI * (int64_t)LOOP_HZ));
    knee_urad += speed_uradps / (int32_t)LOOP_HZ;
}

void current_loop(void)
{
    uint32_t now_us = board_tick_us();
    drive_bridge(leg_torque_unm(&core, now_us), leg_bridge_now(&core, now_us));
    impulse += bridge_torque_unm;
    loops++;
    trace.loop_us = now_us;
    if (bridge_torque_unm) {
        trace.driven_us = now_us;
        if (!trace.first_us)
            trace.first_us = now_us;
    }
    swing_knee();
}

static leg_sensors read_sensors(void)
{
    leg_sensors s = {.knee_urad = knee_urad, .pivot_hall_urad = 0, .knee_hall_urad = knee_urad, .bus_mv = 24000,
                     .motor_cdegc = 2500, .knee_speed_uradps = speed_uradps};
    uint32_t before = board_hold();
    s.current_ua = loops ? impulse / loops : bridge_torque_unm;
    impulse = loops = 0;
    board_release(before);
    return s;
}

static void send(void *user, const uint8_t *message, size_t size)
{
    uint8_t frame[LEG_FRAME_ROOM];
    (void)user;
    board_send(frame, leg_frame(message, size, frame));
}

static uint32_t tick_us(void *user)
{
    (void)user;
    return board_tick_us();
}

static bool estop_open(void *user)
{
    (void)user;
    return board_estop_open();
}

static void kick(void *user)
{
    (void)user;
    board_watchdog_kick();
}

int main(void)
{
    static const leg_port PORT = {NULL, send, tick_us, estop_open, kick};
    uint8_t bytes[256];
    uint32_t due_us, last_us;
    board_init();
    due_us = board_tick_us();
    if (leg_init(&core, &CONFIG, &PORT, board_boot_id(), due_us) != LEG_ACCEPTED)
        for (;;)
            continue; /* nothing was started, nothing will move */
    board_watchdog_start();
    __asm volatile("cpsie i" : : : "memory");
    for (;;) {
        size_t n = board_receive(bytes, sizeof bytes, &last_us);
        if (n)
            leg_receive(&core, bytes, n, last_us);
        leg_poll(&core, board_tick_us());
        if ((int32_t)(board_tick_us() - due_us) >= 0) {
            leg_sensors sensors = read_sensors();
            leg_sample(&core, &sensors, due_us);
            due_us += 1000000u / TELEMETRY_HZ;
        }
        board_wait();
    }
}

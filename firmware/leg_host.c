/* The core on a computer, with a leg that stands still and a current loop without delay.
 *
 *   leg_host script [NODE]
 *                     reads a script from stdin, prints what the controller sends; time passes as the script says.
 *                     With NODE on CAN: HEX is then one frame, its identifier in two bytes first
 *   leg_host pty [HZ] serves a pseudo-terminal in real time; prints its path, then a line whenever state or torque
 *                     changes: MONOTONIC_US STATE TORQUE_UNM FAULTS VALUE, the value being that of the last fault
 *   leg_host examine  reads lines NAME VALUE, prints what leg_examine says of the configuration with that change
 *
 * A script's lines, times in us and not decreasing, multiples of 500 except for rx:
 *   T rx HEX          bytes come in          T set NAME VALUE   a reading changes, see set()
 *   T reboot BOOT_ID  power cycle            T end              nothing after it
 *   T stall poll 1    leg_poll is not called any more, or leg_sample, or leg_torque_unm
 *   T jump T2         the clock is T2 at once; nothing was called meanwhile
 * Output: T HEX for each frame; at the end "counts BAD_CRC BAD_LENGTH UNKNOWN LATE" and
 * "torque STATE TORQUE_UNM BRIDGE KICKS".
 * POSIX; not part of the firmware. */
#define _XOPEN_SOURCE 600
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "leg_can.h"

#define STEP_US 500u
#define TURNAROUND_US 20u
#define BEAT_EVERY_US 100000u
#define LINE 4096

typedef struct {
    leg_core core;
    leg_config config;
    leg_sensors sensors;
    int64_t impulse; /* torque times us since the last sample */
    uint32_t steps;
    uint64_t boot_us, now_us; /* in the host's time */
    int terminal;
    int node; /* on CAN; -1 on a serial line */
    int32_t angle_urad;
    bool estop_open, knee_lost, hall_lost, current_lost, no_poll, no_sample, no_torque;
    uint32_t kicks;
} board;

static const leg_config CONFIG = {
    500, 50000, 2000000, 1000, 30000000, 9000, 18000, 30000, 40000000, 32000000, -6280000, 6280000, 300000,
    LEG_LIMP, 20000, 2000, 1500000, 500
};
static const leg_sensors STILL = {0, 0, 0, 0, 24000, 2500, 0, false};

static uint32_t tick(const board *b)
{
    return (uint32_t)(b->now_us - b->boot_us);
}

static uint64_t monotonic_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

static uint32_t scripted_tick(void *user)
{
    return tick(user) + TURNAROUND_US;
}

static uint32_t real_tick(void *user)
{
    return (uint32_t)(monotonic_us() - ((board *)user)->boot_us);
}

static bool estop_open(void *user)
{
    return ((board *)user)->estop_open;
}

static void kick(void *user)
{
    ((board *)user)->kicks++;
}

static void print_line(const board *b, const uint8_t *data, size_t size)
{
    printf("%" PRIu64 " ", b->now_us);
    for (size_t i = 0; i < size; i++)
        printf("%02x", data[i]);
    putchar('\n');
}

/* On CAN a line is the identifier in two bytes, high byte first, and the data. */
static void print_can(void *user, const leg_can_frame *frame)
{
    uint8_t line[10] = {(uint8_t)(frame->id >> 8), (uint8_t)frame->id};
    memcpy(line + 2, frame->data, frame->size);
    print_line(user, line, 2u + frame->size);
}

static void print_message(void *user, const uint8_t *message, size_t size)
{
    board *b = user;
    uint8_t frame[LEG_FRAME_ROOM];
    if (b->node >= 0)
        leg_can_send((uint8_t)b->node, message, print_can, b);
    else
        print_line(b, frame, leg_frame(message, size, frame));
}

static void write_message(void *user, const uint8_t *message, size_t size)
{
    uint8_t frame[LEG_FRAME_ROOM];
    ssize_t written = write(((board *)user)->terminal, frame, leg_frame(message, size, frame));
    (void)written; /* nobody reads the port: the bytes are lost, as on a real UART */
}

static void boot(board *b, uint32_t boot_id, void (*send_to)(void *, const uint8_t *, size_t))
{
    leg_port port = {b, send_to, b->terminal ? real_tick : scripted_tick, estop_open, kick};
    b->boot_us = b->now_us;
    b->impulse = 0;
    b->steps = 0;
    if (leg_init(&b->core, &b->config, &port, boot_id, tick(b)) != LEG_ACCEPTED)
        exit(2);
}

/* One step of the world: watchdog, torque, and at its end the sample that is due. Torque constant: 1 N m/A. */
static void step(board *b)
{
    uint32_t period_us = 1000000u / b->config.telemetry_hz;
    if (!b->no_poll)
        leg_poll(&b->core, tick(b));
    if (!b->no_torque)
        b->impulse += (int64_t)leg_torque_unm(&b->core, tick(b)) * STEP_US;
    b->steps++;
    b->now_us += STEP_US;
    if (tick(b) % period_us == 0 && !b->no_sample) {
        int64_t mean_ua = b->impulse / ((int64_t)b->steps * STEP_US);
        b->sensors.current_ua = b->current_lost ? LEG_INVALID32 : (int32_t)mean_ua;
        b->sensors.knee_urad = b->knee_lost ? LEG_INVALID32 : b->angle_urad;
        b->sensors.knee_hall_urad = b->hall_lost ? LEG_INVALID32 : b->angle_urad;
        leg_sample(&b->core, &b->sensors, tick(b));
        b->impulse = 0;
        b->steps = 0;
    }
    if (b->node >= 0 && tick(b) % BEAT_EVERY_US == 0)
        leg_can_beat(&b->core, (uint8_t)b->node, print_can, b);
}

static void receive(board *b, const uint8_t *bytes, size_t size)
{
    leg_can_frame frame = {0};
    if (b->node < 0) {
        leg_receive(&b->core, bytes, size, tick(b));
    } else if (size >= 2 && size <= 10) {
        frame.id = (uint16_t)(bytes[0] << 8 | bytes[1]);
        frame.size = (uint8_t)(size - 2);
        memcpy(frame.data, bytes + 2, frame.size);
        leg_can_receive(&b->core, (uint8_t)b->node, &frame, tick(b));
    }
}

static int set(board *b, const char *name, long value)
{
    if (!strcmp(name, "knee")) b->knee_lost = value == LEG_INVALID32;
    else if (!strcmp(name, "knee_hall")) b->hall_lost = value == LEG_INVALID32;
    else if (!strcmp(name, "angle")) b->angle_urad = (int32_t)value;
    else if (!strcmp(name, "current")) b->current_lost = value == LEG_INVALID32;
    else if (!strcmp(name, "estop")) b->estop_open = value != 0;
    else if (!strcmp(name, "reaction")) b->config.reaction = b->core.config.reaction = (leg_reaction)value;
    else if (!strcmp(name, "pivot_hall")) b->sensors.pivot_hall_urad = (int32_t)value;
    else if (!strcmp(name, "bus_mv")) b->sensors.bus_mv = (uint16_t)value;
    else if (!strcmp(name, "motor_cdegc")) b->sensors.motor_cdegc = (int16_t)value;
    else if (!strcmp(name, "knee_speed")) b->sensors.knee_speed_uradps = (int32_t)value;
    else if (!strcmp(name, "gate_driver")) b->sensors.gate_driver_fault = value != 0;
    else return 0;
    return 1;
}

static int stall(board *b, const char *what, long value)
{
    if (!strcmp(what, "poll")) b->no_poll = value != 0;
    else if (!strcmp(what, "sample")) b->no_sample = value != 0;
    else if (!strcmp(what, "torque")) b->no_torque = value != 0;
    else return 0;
    return 1;
}

/* One number of a configuration changed by name. */
static int configure(leg_config *c, leg_port *port, const char *name, long value)
{
    if (!strcmp(name, "none")) return 1;
    if (!strcmp(name, "telemetry_hz")) c->telemetry_hz = (uint16_t)value;
    else if (!strcmp(name, "gear_ratio")) c->gear_ratio_milli = (uint32_t)value;
    else if (!strcmp(name, "torque_limit")) c->torque_limit_unm = (int32_t)value;
    else if (!strcmp(name, "watchdog_ms")) c->watchdog_limit_ms = (uint16_t)value;
    else if (!strcmp(name, "current_limit")) c->current_limit_ua = (int32_t)value;
    else if (!strcmp(name, "temperature_limit")) c->temperature_limit_cdegc = (int16_t)value;
    else if (!strcmp(name, "undervoltage")) c->undervoltage_mv = (uint16_t)value;
    else if (!strcmp(name, "overvoltage")) c->overvoltage_mv = (uint16_t)value;
    else if (!strcmp(name, "speed_limit")) c->speed_limit_uradps = (int32_t)value;
    else if (!strcmp(name, "speed_derate")) c->speed_derate_uradps = (int32_t)value;
    else if (!strcmp(name, "position_min")) c->position_min_urad = (int32_t)value;
    else if (!strcmp(name, "position_max")) c->position_max_urad = (int32_t)value;
    else if (!strcmp(name, "position_derate")) c->position_derate_urad = (int32_t)value;
    else if (!strcmp(name, "reaction")) c->reaction = (leg_reaction)value;
    else if (!strcmp(name, "hold_torque")) c->reaction = LEG_HOLD, c->hold_torque_unm = (int32_t)value;
    else if (!strcmp(name, "hold_ms")) c->reaction = LEG_HOLD, c->hold_ms = (uint16_t)value;
    else if (!strcmp(name, "no_kick")) port->kick = NULL;
    else if (!strcmp(name, "no_estop")) port->estop_open = NULL;
    else return 0;
    return 1;
}

static int run_examine(board *b)
{
    char name[32];
    long value;
    while (scanf("%31s %ld", name, &value) == 2) {
        leg_config config = CONFIG;
        leg_port port = {b, write_message, scripted_tick, estop_open, kick};
        if (!configure(&config, &port, name, value))
            return 2;
        printf("%d\n", (int)leg_init(&b->core, &config, &port, 1, 0));
        leg_poll(&b->core, 0); /* a refused core does nothing, and does no harm */
        leg_sample(&b->core, &STILL, 0);
    }
    return 0;
}

static size_t unhex(const char *text, uint8_t *out)
{
    size_t n = 0;
    unsigned byte;
    while (sscanf(text + 2 * n, "%2x", &byte) == 1)
        out[n++] = (uint8_t)byte;
    return n;
}

static int run_script(board *b)
{
    char line[LINE], verb[16], name[32], hex[LINE];
    uint8_t bytes[LINE / 2];
    uint64_t t;
    long value;
    boot(b, 1, print_message);
    while (fgets(line, sizeof line, stdin)) {
        if (sscanf(line, "%" SCNu64 " %15s", &t, verb) != 2)
            return 2;
        while (b->now_us + STEP_US <= t || (b->now_us < t && strcmp(verb, "rx")))
            step(b);
        if (!strcmp(verb, "rx") && sscanf(line, "%*s %*s %4095s", hex) == 1) {
            if (t > b->now_us)
                step(b); /* the byte comes within this step: the world is past it, the stamp is not */
            uint64_t now_us = b->now_us;
            b->now_us = t;
            receive(b, bytes, unhex(hex, bytes));
            b->now_us = now_us;
        } else if (!strcmp(verb, "set") && sscanf(line, "%*s %*s %31s %ld", name, &value) == 2) {
            if (!set(b, name, value))
                return 2;
        } else if (!strcmp(verb, "stall") && sscanf(line, "%*s %*s %31s %ld", name, &value) == 2) {
            if (!stall(b, name, value))
                return 2;
        } else if (!strcmp(verb, "jump") && sscanf(line, "%*s %*s %" SCNu64, &b->now_us) == 1) {
            continue;
        } else if (!strcmp(verb, "reboot") && sscanf(line, "%*s %*s %ld", &value) == 1) {
            boot(b, (uint32_t)value, print_message);
        } else if (!strcmp(verb, "end")) {
            break;
        } else {
            return 2;
        }
    }
    printf("counts %" PRIu32 " %" PRIu32 " %" PRIu32 " %" PRIu32 "\n", b->core.bad_crc, b->core.bad_length,
           b->core.unknown, b->core.late);
    printf("torque %d %" PRId32 " %d %" PRIu32 "\n", (int)b->core.state, leg_torque_unm(&b->core, tick(b)),
           (int)leg_bridge_now(&b->core, tick(b)), b->kicks);
    return 0;
}

static int serve(board *b)
{
    struct termios raw;
    uint8_t bytes[4096];
    int state = -1;
    int32_t torque = 0;
    b->terminal = posix_openpt(O_RDWR | O_NOCTTY);
    if (b->terminal < 0 || grantpt(b->terminal) || unlockpt(b->terminal))
        return 1;
    int kept_open = open(ptsname(b->terminal), O_RDWR | O_NOCTTY); /* else a host that leaves hangs the line up */
    if (kept_open < 0 || tcgetattr(kept_open, &raw))
        return 1;
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    tcsetattr(kept_open, TCSANOW, &raw);
    fcntl(b->terminal, F_SETFL, O_NONBLOCK);
    setvbuf(stdout, NULL, _IOLBF, 0);
    puts(ptsname(b->terminal));
    b->now_us = monotonic_us();
    boot(b, (uint32_t)(b->now_us | 1u), write_message);
    for (;;) {
        struct pollfd in = {b->terminal, POLLIN, 0};
        uint64_t now_us = monotonic_us();
        if (b->now_us > now_us)
            poll(&in, 1, 1);
        ssize_t n = read(b->terminal, bytes, sizeof bytes);
        if (n > 0) {
            uint64_t world_us = b->now_us;
            b->now_us = monotonic_us();
            leg_receive(&b->core, bytes, (size_t)n, tick(b));
            b->now_us = world_us;
        }
        now_us = monotonic_us();
        while (b->now_us <= now_us)
            step(b);
        if ((int)b->core.state != state || leg_torque_unm(&b->core, tick(b)) != torque) {
            state = (int)b->core.state;
            torque = leg_torque_unm(&b->core, tick(b));
            printf("%" PRIu64 " %d %" PRId32 " %u %" PRId32 "\n", monotonic_us(), state, torque,
                   (unsigned)b->core.latched,
                   b->core.latched_value[b->core.latched_count ? b->core.latched_count - 1 : 0]);
        }
    }
}

int main(int argc, char **argv)
{
    static board b;
    b.config = CONFIG;
    b.sensors = STILL;
    b.node = -1;
    if (argc == 3 && !strcmp(argv[1], "script"))
        b.node = atoi(argv[2]);
    if (argc >= 2 && !strcmp(argv[1], "script"))
        return run_script(&b);
    if (argc == 2 && !strcmp(argv[1], "examine"))
        return run_examine(&b);
    if (argc == 3 && !strcmp(argv[1], "pty"))
        b.config.telemetry_hz = (uint16_t)atoi(argv[2]);
    if (argc >= 2 && !strcmp(argv[1], "pty") && b.config.telemetry_hz && 2000 % b.config.telemetry_hz == 0)
        return serve(&b);
    fputs("usage: leg_host script [NODE] | examine | pty [HZ, a divisor of 2000]\n", stderr);
    return 2;
}

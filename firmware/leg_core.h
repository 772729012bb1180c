/* The leg controller of firmware_protocol.md, version 1: drive states, watchdog, limits, latched faults, messages.
 *
 * Start here when building a controller. The board's part is five calls and four functions:
 *   leg_init       once at boot, before the bridge gets power; nothing else when it refuses the configuration
 *   leg_receive    bytes from the host, with the tick at which the last of them came in (on CAN: leg_can_receive)
 *   leg_poll       at 1 kHz or faster: E-stop, watchdog, hardware watchdog
 *   leg_sample     once per telemetry period: limits are checked, Telemetry goes out
 *   leg_torque_unm in the current loop, at 1 kHz or faster, with the tick: what the loop is asked for
 * The first four belong to one context (or behind one lock). leg_torque_unm and leg_bridge_now may interrupt them: they
 * decide by the tick alone, so that torque is zero in time even where nobody calls leg_poll or leg_sample any more.
 *
 * What the board must have besides (port_lm3s6965/ is an example):
 *   - a watchdog of the hardware with a clock of its own, that no software can stop once it runs, of at most 50 ms.
 *     Only leg_port.kick restarts it; the core calls that while leg_poll, leg_sample and leg_torque_unm all run
 *     and the tick advances.
 *   - a bridge that is off while the processor is in reset, so that the hardware watchdog's reset is torque zero.
 *   - an E-stop contact that is closed while all is well, read by leg_port.estop_open, so that a broken wire reads as
 *     pressed; the same contact must take the bridge's supply or its enable away without any software (IEC 60204-1,
 *     category 0). What this core does with it is to latch, to tell, and to refuse.
 * C99, integers only, no allocation. MIT. */
#ifndef LEG_CORE_H
#define LEG_CORE_H

#include "leg_codec.h"

#define LEG_VERSION 1
#define LEG_INVALID32 INT32_MIN /* a reading that was not had */
#define LEG_INVALID16 INT16_MIN
#define LEG_INVALID_MV 0xFFFFu
#define LEG_WATCHDOG_MS_MIN 5
#define LEG_WATCHDOG_MS_MAX 1000
#define LEG_FAULTS 13
#define LEG_ESTOP_OPEN 0x8000u /* in Telemetry's faults: the E-stop input is open now */

/* Messages of section 3. */
enum {
    LEG_TORQUE_COMMAND = 0x01, LEG_ARM = 0x02, LEG_STOP = 0x03, LEG_CLEAR_FAULTS = 0x04, LEG_HELLO_REQUEST = 0x05,
    LEG_PING = 0x06, LEG_TIMED_COMMAND = 0x07, LEG_LIMITS_REQUEST = 0x08,
    LEG_TELEMETRY = 0x81, LEG_HELLO = 0x82, LEG_PONG = 0x83, LEG_FAULT_REPORT = 0x84, LEG_DRIVE_LIMITS = 0x85
};

typedef enum { LEG_DISARMED = 0, LEG_ARMED = 1, LEG_FAULT = 2 } leg_state;

/* Bits of section 8. */
enum {
    LEG_WATCHDOG = 1 << 0,
    LEG_OVERCURRENT = 1 << 1,
    LEG_OVERTEMPERATURE = 1 << 2,
    LEG_UNDERVOLTAGE = 1 << 3,
    LEG_OVERVOLTAGE = 1 << 4,
    LEG_KNEE_ENCODER = 1 << 5,
    LEG_KNEE_HALL = 1 << 6,
    LEG_COMMAND_LIMIT = 1 << 7,
    LEG_OVERSPEED = 1 << 8,
    LEG_GATE_DRIVER = 1 << 9,
    LEG_INTERNAL = 1 << 10,
    LEG_ESTOP = 1 << 11,
    LEG_POSITION_LIMIT = 1 << 12
};

/* Features of DriveLimits. */
enum { LEG_TIMED_COMMANDS = 1 << 0, LEG_ESTOP_INPUT = 1 << 1 };

/* What the drive does at a fault behind which its own sensors are sound (section 8); at others it goes limp. */
typedef enum { LEG_LIMP = 0, LEG_BRAKE = 1, LEG_HOLD = 2 } leg_reaction;

/* What the bridge is to do. */
typedef enum { LEG_BRIDGE_OFF = 0, LEG_BRIDGE_DRIVEN = 1, LEG_BRIDGE_SHORTED = 2 } leg_bridge;

/* What the board is. */
typedef struct {
    uint16_t telemetry_hz;
    uint32_t gear_ratio_milli;
    int32_t torque_limit_unm; /* 1e-6 N m */
    uint16_t watchdog_limit_ms;
    int32_t current_limit_ua;
    int16_t temperature_limit_cdegc; /* 0.01 degC */
    uint16_t undervoltage_mv, overvoltage_mv;
    int32_t speed_limit_uradps, speed_derate_uradps; /* torque that speeds up shrinks from the second to the first */
    int32_t position_min_urad, position_max_urad;    /* of the knee encoder's angle, as Telemetry has it */
    int32_t position_derate_urad; /* that far before them torque towards them begins to shrink; 0: it does not */
    leg_reaction reaction;
    /* For LEG_HOLD: torque per angle [1e-3 N m/rad] and speed [1e-3 N m s/rad], its bound [1e-6 N m], its time. */
    int32_t hold_stiffness_milli, hold_damping_milli, hold_torque_unm;
    uint16_t hold_ms;
} leg_config;

/* The first thing that is wrong with a configuration. */
typedef enum {
    LEG_ACCEPTED = 0, LEG_BAD_PORT, LEG_BAD_BOOT_ID, LEG_BAD_TELEMETRY_HZ, LEG_BAD_GEAR_RATIO, LEG_BAD_TORQUE_LIMIT,
    LEG_BAD_WATCHDOG, LEG_BAD_CURRENT_LIMIT, LEG_BAD_TEMPERATURE_LIMIT, LEG_BAD_VOLTAGES, LEG_BAD_SPEED_LIMIT,
    LEG_BAD_POSITION_LIMITS, LEG_BAD_REACTION
} leg_refusal;

/* One telemetry period's readings, in the units of section 4; LEG_INVALID where a reading was not had. Only the pivot's
 * may be missing: a limit that cannot be checked has tripped. */
typedef struct {
    int32_t knee_urad, pivot_hall_urad, knee_hall_urad;
    int32_t current_ua; /* mean since the sample before */
    uint16_t bus_mv;
    int16_t motor_cdegc;
    int32_t knee_speed_uradps; /* for the limit only */
    bool gate_driver_fault;
} leg_sensors;

/* What the core needs of the board; all four are a must. */
typedef struct {
    void *user;
    /* Queue a message, type byte first, for the host: through leg_frame on a serial line, leg_can_send on CAN. */
    void (*send)(void *user, const uint8_t *message, size_t size);
    uint32_t (*tick_us)(void *user); /* the clock now; read as a Pong is handed over */
    bool (*estop_open)(void *user);   /* the E-stop is pressed, or its wire broken */
    void (*kick)(void *user);         /* restart the hardware watchdog */
} leg_port;

typedef struct {
    leg_config config;
    leg_port port;
    leg_receiver receiver;
    uint32_t boot_id, hello_due_us;
    leg_refusal refusal;
    /* volatile: leg_torque_unm may interrupt whoever changes these */
    volatile leg_state state;
    volatile leg_reaction reaction; /* to the faults that are latched; LEG_LIMP but in FAULT */
    volatile int32_t torque_unm;    /* after derating */
    volatile int32_t watchdog_us;
    volatile uint32_t fed_us, sampled_us, held_from_us;
    volatile uint16_t starved; /* the fault for which leg_torque_unm refused */
    volatile bool torque_read; /* somebody asked for torque since the last kick */
    int32_t asked_unm; /* before derating */
    int32_t sample_late_us;
    uint32_t kicked_us; /* the hardware watchdog was restarted last */
    int32_t knee_urad, speed_uradps; /* of the last sample */
    int32_t held_urad;
    uint16_t command_seq, telemetry_seq;
    bool commanded, timed, stopped;
    uint16_t latched, present; /* faults; causes that the last sample saw */
    uint8_t latched_count;
    uint16_t latched_fault[LEG_FAULTS]; /* in the order in which they latched */
    int32_t latched_value[LEG_FAULTS];
    uint32_t bad_crc, bad_length, unknown; /* frames dropped */
    uint32_t late; /* commands ignored for their sequence number or their age */
} leg_core;

/* What is wrong with them; leg_init asks. */
leg_refusal leg_examine(const leg_config *config, const leg_port *port, uint32_t boot_id);

/* boot_id: random, not zero, another at every boot. A configuration or port that cannot be right is refused: the core
 * then sends nothing, obeys nothing and never kicks the hardware watchdog. */
leg_refusal leg_init(leg_core *core, const leg_config *config, const leg_port *port, uint32_t boot_id, uint32_t now_us);
void leg_receive(leg_core *core, const uint8_t *data, size_t size, uint32_t now_us);
/* A message that came whole; leg_receive takes it out of the bytes. */
void leg_obey(leg_core *core, const uint8_t *message, size_t size, uint32_t now_us);
void leg_poll(leg_core *core, uint32_t now_us);
void leg_sample(leg_core *core, const leg_sensors *sensors, uint32_t now_us);

/* Latch a fault from elsewhere (gate driver interrupt, assertion): torque is zero when this returns. */
void leg_trip(leg_core *core, uint16_t fault, int32_t value, uint32_t now_us);

/* Joint torque that the current loop is asked for, at the tick of the call: zero unless ARMED (or holding), and zero
 * from the moment on at which the watchdog's time is over or the samples have stopped, whether or not anyone polls. */
int32_t leg_torque_unm(leg_core *core, uint32_t now_us);
leg_bridge leg_bridge_now(leg_core *core, uint32_t now_us);

#endif

/* The leg controller of firmware_protocol.md, version 1: drive states, watchdog, latched faults, messages.
 *
 * Start here when building a controller. The board's part is four calls and two functions:
 *   leg_init     once at boot: Hello goes out, torque is zero
 *   leg_receive  bytes from the host, with the tick at which the last of them came in (on CAN: leg_can_receive)
 *   leg_poll     at 1 kHz or faster: the watchdog
 *   leg_sample   once per telemetry period: limits are checked, Telemetry goes out
 * leg_torque_unm() is what the current loop is asked for; read it in the loop itself, it is zero unless ARMED.
 * All four calls belong to one context (or behind one lock). C99, integers only, no allocation. MIT. */
#ifndef LEG_CORE_H
#define LEG_CORE_H

#include "leg_codec.h"

#define LEG_VERSION 1
#define LEG_INVALID32 INT32_MIN /* a reading that was not had */
#define LEG_INVALID16 INT16_MIN
#define LEG_INVALID_MV 0xFFFFu
#define LEG_FAULTS 11

/* Messages of section 3. */
enum {
    LEG_TORQUE_COMMAND = 0x01, LEG_ARM = 0x02, LEG_STOP = 0x03, LEG_CLEAR_FAULTS = 0x04, LEG_HELLO_REQUEST = 0x05,
    LEG_PING = 0x06, LEG_TELEMETRY = 0x81, LEG_HELLO = 0x82, LEG_PONG = 0x83, LEG_FAULT_REPORT = 0x84
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
    LEG_INTERNAL = 1 << 10
};

/* What the board is. */
typedef struct {
    uint16_t telemetry_hz;
    uint32_t gear_ratio_milli;
    int32_t torque_limit_unm; /* 1e-6 N m */
    uint16_t watchdog_limit_ms;
    int32_t current_limit_ua;
    int16_t temperature_limit_cdegc; /* 0.01 degC */
    uint16_t undervoltage_mv, overvoltage_mv;
    int32_t speed_limit_uradps;
} leg_config;

/* One telemetry period's readings, in the units of section 4. */
typedef struct {
    int32_t knee_urad, pivot_hall_urad, knee_hall_urad;
    int32_t current_ua; /* mean since the sample before */
    uint16_t bus_mv;
    int16_t motor_cdegc;
    int32_t knee_speed_uradps; /* for the limit only; LEG_INVALID32 while the knee encoder is lost */
    bool gate_driver_fault;
} leg_sensors;

/* What the core needs of the board. */
typedef struct {
    void *user;
    /* Queue a message, type byte first, for the host: through leg_frame on a serial line, leg_can_send on CAN. */
    void (*send)(void *user, const uint8_t *message, size_t size);
    uint32_t (*tick_us)(void *user); /* the clock now; read as a Pong is handed over */
} leg_port;

typedef struct {
    leg_config config;
    leg_port port;
    leg_receiver receiver;
    uint32_t boot_id, hello_due_us;
    leg_state state;
    int32_t torque_unm;
    int32_t watchdog_us;
    uint32_t fed_us;
    uint16_t command_seq, telemetry_seq;
    bool commanded, stopped;
    uint16_t latched, present; /* faults; causes that the last sample saw */
    uint8_t latched_count;
    uint16_t latched_fault[LEG_FAULTS]; /* in the order in which they latched */
    int32_t latched_value[LEG_FAULTS];
    uint32_t bad_crc, bad_length, unknown; /* frames dropped */
} leg_core;

/* boot_id: random, not zero, another at every boot. */
void leg_init(leg_core *core, const leg_config *config, const leg_port *port, uint32_t boot_id, uint32_t now_us);
void leg_receive(leg_core *core, const uint8_t *data, size_t size, uint32_t now_us);
/* A message that came whole; leg_receive takes it out of the bytes. */
void leg_obey(leg_core *core, const uint8_t *message, size_t size, uint32_t now_us);
void leg_poll(leg_core *core, uint32_t now_us);
void leg_sample(leg_core *core, const leg_sensors *sensors, uint32_t now_us);

/* Latch a fault from elsewhere (gate driver interrupt, assertion): torque is zero when this returns. */
void leg_trip(leg_core *core, uint16_t fault, int32_t value, uint32_t now_us);

int32_t leg_torque_unm(const leg_core *core);

#endif

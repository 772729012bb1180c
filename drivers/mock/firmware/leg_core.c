#include "leg_core.h"

#define WATCHDOG_MS_MIN 5u
#define HELLO_EVERY_US 1000000u

/* Length of a message from the host, type byte included; 0: no such message. */
static size_t length_of(uint8_t type)
{
    switch (type) {
    case LEG_TORQUE_COMMAND: return 7;
    case LEG_ARM: case LEG_PING: return 3;
    case LEG_STOP: case LEG_CLEAR_FAULTS: case LEG_HELLO_REQUEST: return 1;
    default: return 0;
    }
}

/* A reading times a factor, or the invalid value where that does not fit. */
static int32_t scaled(int32_t value, int32_t factor)
{
    int64_t product = (int64_t)value * factor;
    return product > INT32_MAX || product < -INT32_MAX ? LEG_INVALID32 : (int32_t)product;
}

static bool beyond(int32_t value, int32_t limit)
{
    return value != LEG_INVALID32 && (value > limit || value < -limit);
}

/* ---- messages up ---- */

static void send(leg_core *core, const uint8_t *payload, size_t size)
{
    core->port.send(core->port.user, payload, size);
}

static void send_hello(leg_core *core)
{
    uint8_t p[19] = {LEG_HELLO};
    leg_put16(p + 1, LEG_VERSION);
    leg_put32(p + 3, core->boot_id);
    leg_put16(p + 7, core->config.telemetry_hz);
    leg_put32(p + 9, core->config.gear_ratio_milli);
    leg_put32(p + 13, (uint32_t)core->config.torque_limit_unm);
    leg_put16(p + 17, core->config.watchdog_limit_ms);
    send(core, p, sizeof p);
}

static void send_fault(leg_core *core, uint16_t fault, int32_t value, uint32_t now_us)
{
    uint8_t p[13] = {LEG_FAULT_REPORT};
    leg_put32(p + 1, now_us);
    leg_put16(p + 5, fault);
    leg_put16(p + 7, core->latched);
    leg_put32(p + 9, (uint32_t)value);
    send(core, p, sizeof p);
}

static void send_pong(leg_core *core, uint16_t ping_id, uint32_t rx_tick_us)
{
    uint8_t p[11] = {LEG_PONG};
    leg_put16(p + 1, ping_id);
    leg_put32(p + 3, rx_tick_us);
    leg_put32(p + 7, core->port.tick_us(core->port.user));
    send(core, p, sizeof p);
}

static void send_telemetry(leg_core *core, const leg_sensors *s, uint32_t now_us)
{
    uint8_t p[34] = {LEG_TELEMETRY};
    leg_put16(p + 1, core->telemetry_seq++);
    leg_put32(p + 3, now_us);
    p[7] = (uint8_t)core->state;
    leg_put16(p + 8, core->latched);
    leg_put32(p + 10, (uint32_t)s->knee_urad);
    leg_put32(p + 14, (uint32_t)s->pivot_hall_urad);
    leg_put32(p + 18, (uint32_t)s->knee_hall_urad);
    leg_put32(p + 22, (uint32_t)s->current_ua);
    leg_put16(p + 26, s->bus_mv);
    leg_put16(p + 28, (uint16_t)s->motor_cdegc);
    leg_put32(p + 30, (uint32_t)core->torque_unm);
    send(core, p, sizeof p);
}

/* ---- the drive, section 8 ---- */

void leg_trip(leg_core *core, uint16_t fault, int32_t value, uint32_t now_us)
{
    if (core->latched & fault || core->latched_count >= LEG_FAULTS)
        return; /* latched already, with its first value */
    core->state = LEG_FAULT;
    core->torque_unm = 0;
    core->stopped = false;
    core->latched |= fault;
    core->latched_fault[core->latched_count] = fault;
    core->latched_value[core->latched_count++] = value;
    send_fault(core, fault, value, now_us);
}

static void arm(leg_core *core, uint16_t watchdog_ms, uint32_t now_us)
{
    if (core->latched) {
        for (uint8_t i = 0; i < core->latched_count; i++)
            send_fault(core, core->latched_fault[i], core->latched_value[i], now_us);
    } else if (core->state == LEG_DISARMED && watchdog_ms >= WATCHDOG_MS_MIN
               && watchdog_ms <= core->config.watchdog_limit_ms) {
        core->state = LEG_ARMED;
        core->torque_unm = 0;
        core->commanded = false;
        core->watchdog_us = watchdog_ms * 1000;
        core->fed_us = now_us;
    }
}

static void command(leg_core *core, uint16_t seq, int32_t torque_unm, uint32_t now_us)
{
    uint16_t ahead = (uint16_t)(seq - core->command_seq);
    if (core->state != LEG_ARMED || (core->commanded && (ahead == 0 || ahead >= 0x8000u)))
        return;
    if (torque_unm == LEG_INVALID32 || beyond(torque_unm, core->config.torque_limit_unm)) {
        leg_trip(core, LEG_COMMAND_LIMIT, torque_unm, now_us);
        return;
    }
    core->commanded = true;
    core->command_seq = seq;
    core->torque_unm = torque_unm;
    core->fed_us = now_us;
}

static void stop(leg_core *core)
{
    core->torque_unm = 0;
    core->stopped = true;
    if (core->state == LEG_ARMED)
        core->state = LEG_DISARMED;
}

static void clear_faults(leg_core *core)
{
    if (core->state != LEG_FAULT || !core->stopped || core->present)
        return;
    core->state = LEG_DISARMED;
    core->latched = 0;
    core->latched_count = 0;
}

void leg_poll(leg_core *core, uint32_t now_us)
{
    /* signed: a frame may be stamped after the tick that this poll was called with */
    int32_t silent_us = (int32_t)(now_us - core->fed_us);
    if (core->state == LEG_ARMED && silent_us >= core->watchdog_us)
        leg_trip(core, LEG_WATCHDOG, scaled(silent_us, 1000), now_us);
}

static void check(leg_core *core, bool wrong, uint16_t fault, int32_t value, uint32_t now_us)
{
    if (!wrong)
        return;
    core->present |= fault;
    leg_trip(core, fault, value, now_us);
}

void leg_sample(leg_core *core, const leg_sensors *s, uint32_t now_us)
{
    const leg_config *c = &core->config;
    int32_t current_ua = s->current_ua == LEG_INVALID32 || s->current_ua >= 0 ? s->current_ua : -s->current_ua;
    core->present = 0;
    check(core, beyond(s->current_ua, c->current_limit_ua), LEG_OVERCURRENT, current_ua, now_us);
    check(core, s->motor_cdegc > c->temperature_limit_cdegc, LEG_OVERTEMPERATURE, scaled(s->motor_cdegc, 10000), now_us);
    check(core, s->bus_mv < c->undervoltage_mv, LEG_UNDERVOLTAGE, scaled(s->bus_mv, 1000), now_us);
    check(core, s->bus_mv != LEG_INVALID_MV && s->bus_mv > c->overvoltage_mv, LEG_OVERVOLTAGE, scaled(s->bus_mv, 1000),
          now_us);
    check(core, s->knee_urad == LEG_INVALID32, LEG_KNEE_ENCODER, LEG_INVALID32, now_us);
    check(core, s->knee_hall_urad == LEG_INVALID32, LEG_KNEE_HALL, LEG_INVALID32, now_us);
    check(core, beyond(s->knee_speed_uradps, c->speed_limit_uradps), LEG_OVERSPEED, s->knee_speed_uradps, now_us);
    check(core, s->gate_driver_fault, LEG_GATE_DRIVER, LEG_INVALID32, now_us);
    send_telemetry(core, s, now_us);
    if ((int32_t)(now_us - core->hello_due_us) >= 0) {
        core->hello_due_us += HELLO_EVERY_US;
        send_hello(core);
    }
}

/* ---- messages down ---- */

void leg_obey(leg_core *core, const uint8_t *p, size_t size, uint32_t now_us)
{
    size_t expected = length_of(p[0]);
    if (expected == 0) {
        core->unknown++;
        return;
    }
    if (size != expected) {
        core->bad_length++;
        return;
    }
    switch (p[0]) {
    case LEG_TORQUE_COMMAND: command(core, leg_get16(p + 1), (int32_t)leg_get32(p + 3), now_us); break;
    case LEG_ARM: arm(core, leg_get16(p + 1), now_us); break;
    case LEG_STOP: stop(core); break;
    case LEG_CLEAR_FAULTS: clear_faults(core); break;
    case LEG_HELLO_REQUEST: send_hello(core); break;
    default: send_pong(core, leg_get16(p + 1), now_us); break;
    }
}

void leg_receive(leg_core *core, const uint8_t *data, size_t size, uint32_t now_us)
{
    uint8_t payload[LEG_MAX_FRAME];
    size_t length = 0;
    for (size_t i = 0; i < size; i++)
        switch (leg_take(&core->receiver, data[i], payload, &length)) {
        case LEG_PAYLOAD: leg_obey(core, payload, length, now_us); break;
        case LEG_BAD_CRC: core->bad_crc++; break;
        case LEG_BAD_LENGTH: core->bad_length++; break;
        default: break;
        }
}

void leg_init(leg_core *core, const leg_config *config, const leg_port *port, uint32_t boot_id, uint32_t now_us)
{
    static const leg_core nothing;
    *core = nothing;
    core->config = *config;
    core->port = *port;
    core->boot_id = boot_id;
    core->hello_due_us = now_us + HELLO_EVERY_US;
    send_hello(core);
}

int32_t leg_torque_unm(const leg_core *core)
{
    return core->state == LEG_ARMED ? core->torque_unm : 0;
}

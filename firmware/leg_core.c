#include "leg_core.h"

#define HELLO_EVERY_US 1000000u
#define LATE_PERIODS 4 /* telemetry periods without a sample: limits are not checked any more */

/* Length of a message from the host, type byte included; 0: no such message. */
static size_t length_of(uint8_t type)
{
    switch (type) {
    case LEG_TIMED_COMMAND: return 9;
    case LEG_TORQUE_COMMAND: return 7;
    case LEG_ARM: case LEG_PING: return 3;
    case LEG_STOP: case LEG_CLEAR_FAULTS: case LEG_HELLO_REQUEST: case LEG_LIMITS_REQUEST: return 1;
    default: return 0;
    }
}

/* A reading times a factor, or the invalid value where that does not fit. */
static int32_t scaled(int32_t value, int32_t factor)
{
    int64_t product = (int64_t)value * factor;
    return product > INT32_MAX || product < -INT32_MAX ? LEG_INVALID32 : (int32_t)product;
}

/* The invalid value, too, is beyond every limit. */
static bool beyond(int32_t value, int32_t limit)
{
    return value == LEG_INVALID32 || value > limit || value < -limit;
}

/* Time since then; signed, for a frame may be stamped after the tick that is called now. */
static int32_t since(uint32_t then_us, uint32_t now_us)
{
    return (int32_t)(now_us - then_us);
}

static bool estop_open(const leg_core *core)
{
    return core->port.estop_open(core->port.user);
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

static void send_limits(leg_core *core)
{
    uint8_t p[16] = {LEG_DRIVE_LIMITS};
    leg_put16(p + 1, LEG_TIMED_COMMANDS | LEG_ESTOP_INPUT);
    p[3] = (uint8_t)core->config.reaction;
    leg_put32(p + 4, (uint32_t)core->config.speed_limit_uradps);
    leg_put32(p + 8, (uint32_t)core->config.position_min_urad);
    leg_put32(p + 12, (uint32_t)core->config.position_max_urad);
    send(core, p, sizeof p);
}

static void send_telemetry(leg_core *core, const leg_sensors *s, uint32_t now_us)
{
    uint8_t p[34] = {LEG_TELEMETRY};
    leg_put16(p + 1, core->telemetry_seq++);
    leg_put32(p + 3, now_us);
    p[7] = (uint8_t)core->state;
    leg_put16(p + 8, (uint16_t)(core->latched | (estop_open(core) ? LEG_ESTOP_OPEN : 0u)));
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

/* What of a torque is left at so many units before a limit, where it begins to shrink `over` units before it. */
static int32_t shrunk(int32_t torque_unm, int64_t before, int64_t over)
{
    if (before >= over)
        return torque_unm;
    return before <= 0 ? 0 : (int32_t)(torque_unm * before / over);
}

/* The torque after derating by the last sample; one that brakes, or leads away from a limit, is left alone. */
static int32_t derated(const leg_core *core, int32_t torque_unm)
{
    const leg_config *c = &core->config;
    int64_t speed = core->speed_uradps, knee = core->knee_urad;
    if (torque_unm < 0)
        speed = -speed;
    if (speed > 0)
        torque_unm = shrunk(torque_unm, c->speed_limit_uradps - speed, c->speed_limit_uradps - c->speed_derate_uradps);
    return shrunk(torque_unm, torque_unm < 0 ? knee - c->position_min_urad : c->position_max_urad - knee,
                  c->position_derate_urad);
}

static int32_t hold_torque(const leg_core *core)
{
    const leg_config *c = &core->config;
    int64_t torque = -((int64_t)c->hold_stiffness_milli * ((int64_t)core->knee_urad - core->held_urad)
                       + (int64_t)c->hold_damping_milli * core->speed_uradps) / 1000;
    if (torque > c->hold_torque_unm)
        return c->hold_torque_unm;
    return torque < -c->hold_torque_unm ? -c->hold_torque_unm : (int32_t)torque;
}

/* Brake and hold are for faults of the host or the motion; with a sensor, the supply or the bridge in doubt, or from
 * any state but ARMED, there is only one way to be safe. */
static leg_reaction reaction_to(const leg_core *core, uint16_t fault, int32_t value)
{
    bool sound = fault == LEG_WATCHDOG || fault == LEG_COMMAND_LIMIT
                 || ((fault == LEG_OVERSPEED || fault == LEG_POSITION_LIMIT) && value != LEG_INVALID32);
    bool acts = core->state == LEG_ARMED || core->reaction != LEG_LIMP;
    return sound && acts ? core->config.reaction : LEG_LIMP;
}

void leg_trip(leg_core *core, uint16_t fault, int32_t value, uint32_t now_us)
{
    if (core->refusal || core->latched & fault || core->latched_count >= LEG_FAULTS)
        return; /* latched already, with its first value */
    leg_reaction reaction = reaction_to(core, fault, value);
    bool begins = core->reaction == LEG_LIMP;
    core->reaction = LEG_LIMP;
    core->state = LEG_FAULT;
    core->asked_unm = 0;
    if (begins || reaction != LEG_HOLD) {
        core->torque_unm = 0;
        core->held_urad = core->knee_urad;
        core->held_from_us = now_us;
    }
    core->reaction = reaction;
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
    } else if (core->state == LEG_DISARMED && watchdog_ms >= LEG_WATCHDOG_MS_MIN
               && watchdog_ms <= core->config.watchdog_limit_ms && !estop_open(core)) {
        core->torque_unm = core->asked_unm = 0;
        core->commanded = core->timed = false;
        core->watchdog_us = watchdog_ms * 1000;
        core->fed_us = now_us;
        core->starved = 0;
        core->state = LEG_ARMED; /* last: the current loop may look in between */
    }
}

static void check_watchdog(leg_core *core, uint32_t now_us)
{
    int32_t silent_us = since(core->fed_us, now_us);
    if (core->state != LEG_ARMED)
        return;
    if (core->starved == LEG_WATCHDOG || silent_us >= core->watchdog_us)
        leg_trip(core, LEG_WATCHDOG, silent_us < 0 ? LEG_INVALID32 : scaled(silent_us, 1000), now_us);
    else if (core->starved || since(core->sampled_us, now_us) >= core->sample_late_us)
        leg_trip(core, LEG_INTERNAL, LEG_INVALID32, now_us); /* no limit is checked any more */
}

/* age_us: how old the newest telemetry is that the host knew of, or 0 where it does not say. */
static void command(leg_core *core, uint16_t seq, int32_t torque_unm, int64_t age_us, bool timed, uint32_t now_us)
{
    uint16_t ahead = (uint16_t)(seq - core->command_seq);
    if (core->starved)
        check_watchdog(core, now_us); /* the current loop has refused torque already: too late */
    if (core->state != LEG_ARMED)
        return;
    age_us += since(now_us, core->port.tick_us(core->port.user)); /* how long it has waited on this board */
    bool behind = core->commanded && (ahead == 0 || ahead >= 0x8000u);
    if (behind || age_us >= core->watchdog_us || (core->timed && !timed)) {
        core->late++;
        return;
    }
    if (beyond(torque_unm, core->config.torque_limit_unm)) {
        leg_trip(core, LEG_COMMAND_LIMIT, torque_unm, now_us);
        return;
    }
    core->commanded = true;
    core->timed = timed;
    core->command_seq = seq;
    core->asked_unm = torque_unm;
    core->torque_unm = derated(core, torque_unm);
    core->fed_us = now_us;
}

/* Age of the telemetry frame that a command answers; one not sent yet is as bad as one from long ago. */
static int64_t age_of(const leg_core *core, uint16_t seen_seq)
{
    uint16_t frames = (uint16_t)(core->telemetry_seq - 1u - seen_seq);
    return (int64_t)frames * (1000000 / core->config.telemetry_hz);
}

static void stop(leg_core *core)
{
    core->reaction = LEG_LIMP;
    core->torque_unm = core->asked_unm = 0;
    core->stopped = true;
    if (core->state == LEG_ARMED)
        core->state = LEG_DISARMED;
}

static void clear_faults(leg_core *core)
{
    if (core->state != LEG_FAULT || !core->stopped || core->present || estop_open(core))
        return;
    core->state = LEG_DISARMED;
    core->latched = 0;
    core->latched_count = 0;
}

void leg_poll(leg_core *core, uint32_t now_us)
{
    if (core->refusal)
        return;
    if (estop_open(core))
        leg_trip(core, LEG_ESTOP, LEG_INVALID32, now_us);
    check_watchdog(core, now_us);
    if (core->reaction == LEG_HOLD && since(core->held_from_us, now_us) >= core->config.hold_ms * 1000)
        core->reaction = LEG_LIMP;
    /* a tick that stands still hides from every check that counts with it */
    if (core->torque_read && now_us != core->kicked_us && since(core->sampled_us, now_us) < core->sample_late_us) {
        core->torque_read = false;
        core->kicked_us = now_us;
        core->port.kick(core->port.user);
    }
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
    int32_t warmth = s->motor_cdegc == LEG_INVALID16 ? LEG_INVALID32 : scaled(s->motor_cdegc, 10000);
    bool hot = warmth == LEG_INVALID32 || s->motor_cdegc > c->temperature_limit_cdegc;
    bool powered = s->bus_mv != LEG_INVALID_MV;
    if (core->refusal)
        return;
    core->present = 0;
    core->knee_urad = s->knee_urad;
    core->speed_uradps = s->knee_speed_uradps;
    check(core, beyond(s->current_ua, c->current_limit_ua), LEG_OVERCURRENT, current_ua, now_us);
    check(core, hot, LEG_OVERTEMPERATURE, warmth, now_us);
    check(core, !powered || s->bus_mv < c->undervoltage_mv, LEG_UNDERVOLTAGE,
          powered ? scaled(s->bus_mv, 1000) : LEG_INVALID32, now_us);
    check(core, powered && s->bus_mv > c->overvoltage_mv, LEG_OVERVOLTAGE, scaled(s->bus_mv, 1000), now_us);
    check(core, s->knee_urad == LEG_INVALID32, LEG_KNEE_ENCODER, LEG_INVALID32, now_us);
    check(core, s->knee_hall_urad == LEG_INVALID32, LEG_KNEE_HALL, LEG_INVALID32, now_us);
    check(core, beyond(s->knee_speed_uradps, c->speed_limit_uradps), LEG_OVERSPEED, s->knee_speed_uradps, now_us);
    check(core, s->gate_driver_fault, LEG_GATE_DRIVER, LEG_INVALID32, now_us);
    bool outside = s->knee_urad < c->position_min_urad || s->knee_urad > c->position_max_urad;
    check(core, outside && s->knee_urad != LEG_INVALID32, LEG_POSITION_LIMIT, s->knee_urad, now_us);
    core->sampled_us = now_us;
    if (core->state == LEG_ARMED)
        core->torque_unm = derated(core, core->asked_unm);
    else if (core->reaction == LEG_HOLD)
        core->torque_unm = hold_torque(core);
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
    if (core->refusal)
        return;
    if (expected == 0) {
        core->unknown++;
        return;
    }
    if (size != expected) {
        core->bad_length++;
        return;
    }
    switch (p[0]) {
    case LEG_TORQUE_COMMAND: command(core, leg_get16(p + 1), (int32_t)leg_get32(p + 3), 0, false, now_us); break;
    case LEG_TIMED_COMMAND:
        command(core, leg_get16(p + 1), (int32_t)leg_get32(p + 3), age_of(core, leg_get16(p + 7)), true, now_us);
        break;
    case LEG_ARM: arm(core, leg_get16(p + 1), now_us); break;
    case LEG_STOP: stop(core); break;
    case LEG_CLEAR_FAULTS: clear_faults(core); break;
    case LEG_HELLO_REQUEST: send_hello(core); break;
    case LEG_LIMITS_REQUEST: send_limits(core); break;
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

/* ---- boot ---- */

leg_refusal leg_init(leg_core *core, const leg_config *config, const leg_port *port, uint32_t boot_id, uint32_t now_us)
{
    static const leg_core nothing;
    *core = nothing;
    core->refusal = leg_examine(config, port, boot_id);
    if (core->refusal)
        return core->refusal;
    core->config = *config;
    core->port = *port;
    core->boot_id = boot_id;
    core->hello_due_us = now_us + HELLO_EVERY_US;
    core->sampled_us = core->kicked_us = now_us;
    core->sample_late_us = LATE_PERIODS * 1000000 / config->telemetry_hz;
    send_hello(core);
    return LEG_ACCEPTED;
}

int32_t leg_torque_unm(leg_core *core, uint32_t now_us)
{
    bool sampled = since(core->sampled_us, now_us) < core->sample_late_us;
    core->torque_read = true;
    if (core->state == LEG_ARMED) {
        /* kept: the tick wraps, and a torque once refused must not come back by itself */
        if (!core->starved && since(core->fed_us, now_us) >= core->watchdog_us)
            core->starved = LEG_WATCHDOG;
        else if (!core->starved && !sampled)
            core->starved = LEG_INTERNAL;
        return core->starved ? 0 : core->torque_unm;
    }
    if (core->reaction == LEG_HOLD) {
        if (!sampled || since(core->held_from_us, now_us) >= core->config.hold_ms * 1000)
            core->reaction = LEG_LIMP;
        else
            return core->torque_unm;
    }
    return 0;
}

leg_bridge leg_bridge_now(leg_core *core, uint32_t now_us)
{
    (void)leg_torque_unm(core, now_us);
    if (core->reaction == LEG_BRAKE)
        return LEG_BRIDGE_SHORTED;
    bool driven = (core->state == LEG_ARMED && !core->starved) || core->reaction == LEG_HOLD;
    return driven ? LEG_BRIDGE_DRIVEN : LEG_BRIDGE_OFF;
}

#include "leg_can.h"

#define MESSAGE_BITS 5
#define INVALID28 (-(1 << 27))

enum {
    FAULT_REPORT = 8, FAULT_VALUE = 9, PONG = 10, TICK = 12, KNEE = 13, HALL = 14, DRIVE = 15, HEARTBEAT = 16,
    HELLO = 17, HELLO_RATES = 18, HELLO_LIMITS = 19, DRIVE_LIMITS = 20, DRIVE_RANGE = 21
};

/* Types of section 3 by message numbers 0 to 7 of section 10. */
static const uint8_t DOWN[] = {LEG_STOP, LEG_TORQUE_COMMAND, LEG_ARM, LEG_CLEAR_FAULTS, LEG_HELLO_REQUEST, LEG_PING,
                               LEG_TIMED_COMMAND, LEG_LIMITS_REQUEST};

/* `bits` low bits of a number, from bit `start` on; two's complement comes out right. */
static uint64_t field(int64_t value, unsigned start, unsigned bits)
{
    return ((uint64_t)value & ((UINT64_C(1) << bits) - 1)) << start;
}

static void emit_word(uint8_t node, unsigned message, uint64_t word, uint8_t size, leg_can_emit emit, void *user)
{
    leg_can_frame frame = {(uint16_t)(node << MESSAGE_BITS | message), size, {0}};
    for (unsigned i = 0; i < size; i++)
        frame.data[i] = (uint8_t)(word >> 8 * i);
    emit(user, &frame);
}

/* A reading in 28 bits; what does not fit is invalid. */
static int32_t reading28(uint32_t raw)
{
    int32_t value = (int32_t)raw;
    return value > INVALID28 && value < -INVALID28 ? value : INVALID28;
}

/* 0.01 degC to 0.1 degC, to the nearest. */
static int32_t tenths(uint16_t raw)
{
    int32_t value = (int16_t)raw;
    int32_t rounded = (value + (value < 0 ? -5 : 5)) / 10;
    return value == LEG_INVALID16 || rounded <= -2048 || rounded > 2047 ? -2048 : rounded;
}

/* faults and state as Tick and Heartbeat have them, in 16 bits: faults 0 to 11, state, fault 12, the E-stop input. */
static uint64_t drive_bits(uint32_t faults, uint32_t state)
{
    return field(faults, 0, 12) | field(state, 12, 2) | field(faults >> 12, 14, 1) | field(faults >> 15, 15, 1);
}

static void send_telemetry(uint8_t node, const uint8_t *m, leg_can_emit emit, void *user)
{
    uint64_t tag = m[1]; /* the low byte of seq */
    emit_word(node, TICK, field(leg_get16(m + 1), 0, 16) | field(leg_get32(m + 3), 16, 32)
              | drive_bits(leg_get16(m + 8), m[7]) << 48, 8, emit, user);
    emit_word(node, KNEE, tag | field(reading28(leg_get32(m + 10)), 8, 28) | field(tenths(leg_get16(m + 28)), 36, 12)
              | field(leg_get16(m + 26), 48, 16), 8, emit, user);
    emit_word(node, HALL, tag | field(reading28(leg_get32(m + 14)), 8, 28)
              | field(reading28(leg_get32(m + 18)), 36, 28), 8, emit, user);
    emit_word(node, DRIVE, tag | field(reading28(leg_get32(m + 22)), 8, 28)
              | field((int32_t)leg_get32(m + 30), 36, 28), 8, emit, user);
}

static void send_hello(uint8_t node, const uint8_t *m, leg_can_emit emit, void *user)
{
    uint64_t tag = leg_get16(m + 3); /* the low half of boot_id */
    emit_word(node, HELLO, field(leg_get16(m + 1), 0, 16) | field(leg_get32(m + 3), 16, 32)
              | field(leg_get16(m + 17), 48, 16), 8, emit, user);
    emit_word(node, HELLO_RATES, tag | field(leg_get32(m + 9), 16, 32) | field(leg_get16(m + 7), 48, 16), 8, emit,
              user);
    emit_word(node, HELLO_LIMITS, tag | field(leg_get32(m + 13), 16, 32), 6, emit, user);
}

static void send_limits(uint8_t node, const uint8_t *m, leg_can_emit emit, void *user)
{
    uint64_t tag = m[1]; /* the low byte of features */
    emit_word(node, DRIVE_LIMITS, field(leg_get16(m + 1), 0, 16) | field(m[3], 16, 8) | field(leg_get32(m + 4), 24, 32),
              7, emit, user);
    emit_word(node, DRIVE_RANGE, tag | field((int32_t)leg_get32(m + 8), 8, 28)
              | field((int32_t)leg_get32(m + 12), 36, 28), 8, emit, user);
}

static void send_fault(uint8_t node, const uint8_t *m, leg_can_emit emit, void *user)
{
    uint16_t bits = leg_get16(m + 5);
    uint32_t tick_us = leg_get32(m + 1), number = 0;
    while (bits >>= 1)
        number++;
    emit_word(node, FAULT_REPORT, field(tick_us, 0, 32) | field(number, 32, 4) | field(leg_get16(m + 7), 36, 12), 6,
              emit, user);
    emit_word(node, FAULT_VALUE, field(number | tick_us << 4, 0, 24) | field(leg_get32(m + 9), 24, 32), 7, emit, user);
}

void leg_can_send(uint8_t node, const uint8_t *message, leg_can_emit emit, void *user)
{
    switch (message[0]) {
    case LEG_TELEMETRY: send_telemetry(node, message, emit, user); break;
    case LEG_HELLO: send_hello(node, message, emit, user); break;
    case LEG_FAULT_REPORT: send_fault(node, message, emit, user); break;
    case LEG_DRIVE_LIMITS: send_limits(node, message, emit, user); break;
    default: /* Pong */
        emit_word(node, PONG, field(leg_get16(message + 1), 0, 16) | field(leg_get32(message + 3), 16, 32)
                  | field(leg_get32(message + 7) - leg_get32(message + 3), 48, 16), 8, emit, user);
    }
}

void leg_can_receive(leg_core *core, uint8_t node, const leg_can_frame *frame, uint32_t now_us)
{
    uint8_t message[9], number = frame->id & ((1 << MESSAGE_BITS) - 1);
    if (frame->id >> MESSAGE_BITS != node || frame->size > 8)
        return;
    message[0] = number < sizeof DOWN ? DOWN[number] : 0; /* 0: no such message, which the core counts */
    for (unsigned i = 0; i < frame->size; i++)
        message[1 + i] = frame->data[i];
    leg_obey(core, message, 1u + frame->size, now_us);
}

void leg_can_beat(const leg_core *core, uint8_t node, leg_can_emit emit, void *user)
{
    if (core->refusal)
        return;
    uint32_t faults = core->latched | (core->port.estop_open(core->port.user) ? LEG_ESTOP_OPEN : 0u);
    emit_word(node, HEARTBEAT, field(core->boot_id, 0, 32) | drive_bits(faults, core->state) << 32, 6, emit, user);
}

/* The firmware core under input that nobody should send. Two ways in:
 *   LLVMFuzzerTestOneInput  for libFuzzer (-DLIBFUZZER -fsanitize=fuzzer,address,undefined): bytes are a session
 *   main FRAMES SEED        a generator of its own, the same on every machine: messages of the protocol with any values,
 *                           whole or mutated, serial and CAN in turn, under readings that come and go
 * After every frame it checks what must hold whatever came, and aborts where it does not. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "leg_can.h"

#define NODE 3

typedef struct {
    leg_core core;
    uint32_t now_us, sent;
    bool can, estop_open;
} session;

static const leg_config CONFIG = {
    500, 50000, 2000000, 1000, 30000000, 9000, 18000, 30000, 40000000, 32000000, -6280000, 6280000, 300000,
    LEG_LIMP, 20000, 2000, 1500000, 500
};
static const int32_t EXTREMES[] = {INT32_MIN, INT32_MIN + 1, -40000000, -1, 0, 1, 6279999, 35000000, INT32_MAX};

static void count(void *user, const leg_can_frame *frame)
{
    if (frame->size > 8 || frame->id >> 5 != NODE)
        abort();
    ((session *)user)->sent++;
}

static void send(void *user, const uint8_t *message, size_t size)
{
    uint8_t frame[LEG_FRAME_ROOM];
    session *s = user;
    size_t n = leg_frame(message, size, frame);
    if (n != size + 4 || frame[n - 1] || memchr(frame, 0, n - 1))
        abort();
    s->sent++;
    leg_can_send(NODE, message, count, s);
}

static uint32_t tick_us(void *user)
{
    return ((session *)user)->now_us;
}

static bool estop_open(void *user)
{
    return ((session *)user)->estop_open;
}

static void kick(void *user)
{
    (void)user;
}

static void boot(session *s, leg_reaction reaction, bool can)
{
    leg_port port = {s, send, tick_us, estop_open, kick};
    leg_config config = CONFIG;
    config.reaction = reaction;
    s->can = can;
    s->estop_open = false;
    if (leg_init(&s->core, &config, &port, s->now_us | 1u, s->now_us) != LEG_ACCEPTED)
        abort();
}

/* What holds at any time. */
static void check(session *s)
{
    leg_core *c = &s->core;
    int32_t torque = leg_torque_unm(c, s->now_us);
    bool held = c->reaction == LEG_HOLD && c->state == LEG_FAULT;
    if (torque > c->config.torque_limit_unm || torque < -c->config.torque_limit_unm)
        abort();
    if (torque && c->state != LEG_ARMED && !held)
        abort();
    if ((c->state == LEG_FAULT) != (c->latched != 0))
        abort();
    if (torque && c->state == LEG_ARMED && (int32_t)(s->now_us - c->fed_us) >= c->watchdog_us)
        abort();
    if (leg_bridge_now(c, s->now_us) == LEG_BRIDGE_OFF && leg_torque_unm(c, s->now_us))
        abort();
}

static void receive(session *s, const uint8_t *bytes, size_t size)
{
    leg_can_frame frame = {0};
    if (!s->can) {
        leg_receive(&s->core, bytes, size, s->now_us);
    } else if (size >= 2) {
        frame.id = (uint16_t)(bytes[0] << 8 | bytes[1]);
        frame.size = (uint8_t)(size - 2); /* also more than eight: a driver may hand on what it read */
        memcpy(frame.data, bytes + 2, size - 2 < 8 ? size - 2 : 8);
        leg_can_receive(&s->core, NODE, &frame, s->now_us);
    }
    check(s);
}

static void pass_time(session *s, uint32_t us, const leg_sensors *sensors)
{
    s->now_us += us;
    leg_poll(&s->core, s->now_us);
    check(s);
    if (sensors)
        leg_sample(&s->core, sensors, s->now_us);
    check(s);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static session s;
    leg_sensors sensors = {0, 0, 0, 0, 24000, 2500, 0, false};
    size_t at = 1;
    if (size < 2)
        return 0;
    boot(&s, (leg_reaction)(data[0] % 3), data[0] & 0x80);
    while (at < size) {
        uint8_t what = data[at++];
        size_t room = size - at, n = what & 31;
        if (n > room)
            n = room;
        if (what & 0x80) {
            receive(&s, data + at, n);
            at += n;
        } else if (n >= 5) {
            int32_t value = (int32_t)leg_get32(data + at + 1);
            int32_t *const readings[] = {&sensors.knee_urad, &sensors.knee_hall_urad, &sensors.current_ua,
                                         &sensors.knee_speed_uradps};
            *readings[data[at] & 3] = value;
            at += 5;
        } else {
            s.estop_open = what & 0x40 && what & 0x20;
            pass_time(&s, n << 9, what & 0x20 ? NULL : &sensors);
        }
    }
    return 0;
}

#ifndef LIBFUZZER
static uint64_t state;

static uint32_t draw(uint32_t below) /* xorshift64*, Vigna 2016 */
{
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return (uint32_t)((state * UINT64_C(2685821657736338717)) >> 32) % below;
}

static int32_t any_reading(int32_t good)
{
    return draw(40) ? good : draw(2) ? EXTREMES[draw(sizeof EXTREMES / sizeof *EXTREMES)] : (int32_t)draw(UINT32_MAX);
}

static size_t message(session *s, uint8_t *m)
{
    static const uint8_t SIZES[] = {0, 7, 3, 1, 1, 1, 3, 9, 1};
    static uint16_t seq;
    uint8_t type = draw(3) ? (draw(2) ? LEG_TORQUE_COMMAND : LEG_TIMED_COMMAND) : (uint8_t)draw(10);
    size_t size = type < sizeof SIZES && SIZES[type] ? SIZES[type] : 1 + draw(LEG_MAX_PAYLOAD);
    for (size_t i = 1; i < size; i++)
        m[i] = (uint8_t)draw(256);
    m[0] = type;
    if (type == LEG_TORQUE_COMMAND || type == LEG_TIMED_COMMAND) {
        leg_put16(m + 1, draw(8) ? ++seq : (uint16_t)draw(65536));
        if (draw(50))
            leg_put32(m + 3, (uint32_t)(draw(4000001) - 2000000u));
        if (type == LEG_TIMED_COMMAND && draw(8))
            leg_put16(m + 7, (uint16_t)(s->core.telemetry_seq - 1u));
    } else if (type == LEG_ARM && draw(4)) {
        leg_put16(m + 1, (uint16_t)(5 + draw(200)));
    }
    return size;
}

static size_t mutate(uint8_t *bytes, size_t size, size_t room)
{
    for (uint32_t left = 1 + draw(3); left && size; left--) {
        size_t at = draw((uint32_t)size), n;
        switch (draw(5)) {
        case 0: bytes[at] ^= (uint8_t)(1u << draw(8)); break;
        case 1: bytes[at] = (uint8_t)draw(256); break;
        case 2: size = at; break;
        case 3: memmove(bytes + at, bytes + at + 1, --size - at); break;
        default:
            n = 1 + draw(80);
            if (size + n <= room) {
                memmove(bytes + at + n, bytes + at, size - at);
                for (size_t i = 0; i < n; i++)
                    bytes[at + i] = (uint8_t)draw(256);
                size += n;
            }
        }
    }
    return size;
}

int main(int argc, char **argv)
{
    static session s;
    uint8_t m[LEG_MAX_FRAME + 2], bytes[512];
    uint64_t armed = 0, driven = 0, faults = 0, dropped = 0, late = 0;
    if (argc != 3)
        return 2;
    uint64_t frames = strtoull(argv[1], NULL, 10);
    state = strtoull(argv[2], NULL, 10) * 2 + 1;
    for (uint64_t k = 0; k < frames; k++) {
        if (k % 4096 == 0) {
            dropped += s.core.bad_crc + s.core.bad_length + s.core.unknown;
            late += s.core.late;
            boot(&s, (leg_reaction)draw(3), k / 4096 & 1);
        }
        size_t size = message(&s, m);
        if (s.can) {
            static const uint8_t NUMBERS[] = {31, 1, 2, 0, 3, 4, 5, 6, 7, 20};
            bytes[0] = 0;
            bytes[1] = (uint8_t)(NODE << 5 | NUMBERS[m[0] % sizeof NUMBERS]);
            size_t data = size - 1 < 8 ? size - 1 : 8;
            memcpy(bytes + 2, m + 1, data);
            size = 2 + data;
        } else {
            size = leg_frame(m, size, bytes);
        }
        if (!draw(3))
            size = mutate(bytes, size, sizeof bytes);
        receive(&s, bytes, s.can && size > 72 ? 72 : size);
        leg_sensors sensors = {any_reading(0), any_reading(0), any_reading(0), any_reading(0),
                               (uint16_t)any_reading(24000), (int16_t)any_reading(2500), any_reading(0), !draw(200)};
        if (s.core.state == LEG_FAULT && !draw(4)) {
            leg_sensors good = {0, 0, 0, 0, 24000, 2500, 0, false};
            s.estop_open = false;
            pass_time(&s, 100, &good);
            uint8_t stop = LEG_STOP, clear = LEG_CLEAR_FAULTS, arm[3] = {LEG_ARM, 200, 0};
            leg_obey(&s.core, &stop, 1, s.now_us);
            leg_obey(&s.core, &clear, 1, s.now_us);
            leg_obey(&s.core, arm, 3, s.now_us);
            faults++;
        }
        if (!draw(300))
            s.estop_open = draw(2);
        pass_time(&s, draw(3000), draw(3) ? &sensors : NULL);
        if (!draw(2000))
            s.now_us += draw(UINT32_MAX); /* nobody called anything meanwhile */
        armed += s.core.state == LEG_ARMED;
        driven += leg_torque_unm(&s.core, s.now_us) != 0;
    }
    printf("%" PRIu64 " frames, %" PRIu64 " times armed, %" PRIu64 " times driven, %" PRIu64 " recoveries, %" PRIu64
           " drops counted, %" PRIu64 " late\n", frames, armed, driven, faults, dropped, late);
    return 0;
}
#endif

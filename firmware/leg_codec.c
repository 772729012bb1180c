#include "leg_codec.h"

uint16_t leg_crc16(const uint8_t *data, size_t size)
{
    uint32_t crc = 0xFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= (uint32_t)data[i] << 8;
        for (int bit = 0; bit < 8; bit++)
            crc = (crc << 1) ^ ((crc & 0x8000u) ? 0x1021u : 0u);
        crc &= 0xFFFFu;
    }
    return (uint16_t)crc;
}

size_t leg_frame(const uint8_t *payload, size_t size, uint8_t *out)
{
    uint16_t crc = leg_crc16(payload, size);
    size_t code = 0, at = 1; /* where the running block's length goes, and the next byte; no block reaches 254 */
    for (size_t i = 0; i < size + 2; i++) {
        uint8_t byte = i < size ? payload[i] : (uint8_t)(i == size ? crc & 0xFFu : crc >> 8);
        if (byte) {
            out[at++] = byte;
        } else {
            out[code] = (uint8_t)(at - code);
            code = at++;
        }
    }
    out[code] = (uint8_t)(at - code);
    out[at++] = 0;
    return at;
}

#define NOT_COBS (LEG_MAX_FRAME + 1)

/* COBS decoded into out; the size, or NOT_COBS when a block reaches beyond the frame. */
static size_t unstuff(const uint8_t *frame, size_t size, uint8_t *out)
{
    size_t in = 0, n = 0;
    while (in < size) {
        size_t end = in + frame[in];
        if (end > size)
            return NOT_COBS;
        for (in++; in < end; in++)
            out[n++] = frame[in];
        if (end < size)
            out[n++] = 0;
    }
    return n;
}

leg_framing leg_take(leg_receiver *receiver, uint8_t byte, uint8_t *payload, size_t *size)
{
    size_t got = receiver->size;
    bool too_long = receiver->too_long;
    if (byte) {
        if (got < LEG_MAX_FRAME)
            receiver->frame[receiver->size++] = byte;
        else
            receiver->too_long = true;
        return LEG_NOTHING;
    }
    receiver->size = 0;
    receiver->too_long = false;
    if (got == 0)
        return LEG_NOTHING;
    if (too_long)
        return LEG_BAD_LENGTH;
    size_t n = unstuff(receiver->frame, got, payload);
    if (n == NOT_COBS)
        return LEG_BAD_CRC;
    if (n < 3)
        return LEG_BAD_LENGTH;
    *size = n - 2;
    return leg_crc16(payload, *size) == leg_get16(payload + *size) ? LEG_PAYLOAD : LEG_BAD_CRC;
}

void leg_put16(uint8_t *to, uint16_t value)
{
    to[0] = (uint8_t)(value & 0xFFu);
    to[1] = (uint8_t)(value >> 8);
}

void leg_put32(uint8_t *to, uint32_t value)
{
    leg_put16(to, (uint16_t)(value & 0xFFFFu));
    leg_put16(to + 2, (uint16_t)(value >> 16));
}

uint16_t leg_get16(const uint8_t *from)
{
    return (uint16_t)(from[0] | from[1] << 8);
}

uint32_t leg_get32(const uint8_t *from)
{
    return leg_get16(from) | (uint32_t)leg_get16(from + 2) << 16;
}

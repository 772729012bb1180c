/* Framing of firmware_protocol.md, section 2: CRC-16/CCITT-FALSE, COBS, one zero byte behind each frame.
 * C99, integers only, no allocation, no dependencies. MIT. */
#ifndef LEG_CODEC_H
#define LEG_CODEC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define LEG_MAX_FRAME 64 /* longest frame without its delimiter [bytes] */
#define LEG_MAX_PAYLOAD 34 /* Telemetry */
#define LEG_FRAME_ROOM (LEG_MAX_PAYLOAD + 4) /* CRC, COBS' one byte, delimiter */

/* What a byte completed. */
typedef enum { LEG_NOTHING, LEG_PAYLOAD, LEG_BAD_LENGTH, LEG_BAD_CRC } leg_framing;

/* A receiver's state: the frame that is coming in. */
typedef struct {
    uint8_t frame[LEG_MAX_FRAME];
    uint8_t size;
    bool too_long;
} leg_receiver;

uint16_t leg_crc16(const uint8_t *data, size_t size);

/* Frame of a payload of 1 to LEG_MAX_PAYLOAD bytes into out[size + 4]; returns its length, delimiter included. */
size_t leg_frame(const uint8_t *payload, size_t size, uint8_t *out);

/* One byte from the wire. LEG_PAYLOAD: payload[0 .. *size) is whole; it has room for LEG_MAX_FRAME bytes. */
leg_framing leg_take(leg_receiver *receiver, uint8_t byte, uint8_t *payload, size_t *size);

/* Little-endian fields. */
void leg_put16(uint8_t *to, uint16_t value);
void leg_put32(uint8_t *to, uint32_t value);
uint16_t leg_get16(const uint8_t *from);
uint32_t leg_get32(const uint8_t *from);

#endif

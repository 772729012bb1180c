/* The core's messages on classic CAN, firmware_protocol.md section 10. C99, integers only, no dependencies. MIT.
 *
 * A board on CAN uses this in place of leg_codec: its port's send hands the message to leg_can_send, every frame of its
 * node goes to leg_can_receive, and ten times a second it calls leg_can_beat. */
#ifndef LEG_CAN_H
#define LEG_CAN_H

#include "leg_core.h"

typedef struct {
    uint16_t id; /* 11 bits: node * 32 + message */
    uint8_t size;
    uint8_t data[8];
} leg_can_frame;

/* Queue a frame for the bus; frames go out in the order in which they are given. */
typedef void (*leg_can_emit)(void *user, const leg_can_frame *frame);

void leg_can_send(uint8_t node, const uint8_t *message, leg_can_emit emit, void *user);
void leg_can_receive(leg_core *core, uint8_t node, const leg_can_frame *frame, uint32_t now_us);
void leg_can_beat(const leg_core *core, uint8_t node, leg_can_emit emit, void *user);

#endif

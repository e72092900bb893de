/* Frames of handle protocol 1: COBS(payload + CRC) + 0x00, see PROTOCOL.md. C99, no allocation, no library. */
#ifndef HANDLE_FRAME_H
#define HANDLE_FRAME_H

#include <stdint.h>

#define FRAME_MAX_PAYLOAD 60
/* Longest frame on the line: payload, CRC, one byte of COBS, closing zero. */
#define FRAME_MAX_WIRE (FRAME_MAX_PAYLOAD + 4)

struct frame_reader {
    uint8_t bytes[FRAME_MAX_PAYLOAD + 3];
    uint8_t length;
    uint8_t too_long;
    uint16_t errors;
};

/* CRC-16/CCITT-FALSE of a payload: polynomial 0x1021, start 0xFFFF; "123456789" gives 0x29B1. */
uint16_t frame_crc(const uint8_t *payload, uint8_t length);

/* Encodes a payload of at most FRAME_MAX_PAYLOAD bytes; returns the length on the line. */
uint8_t frame_encode(const uint8_t *payload, uint8_t length, uint8_t wire[FRAME_MAX_WIRE]);

/* Takes a byte from the line; when it completes a good frame, returns the length of the payload at `reader->bytes`,
 * else 0. */
uint8_t frame_take(struct frame_reader *reader, uint8_t byte);

#endif

#include "frame.h"

uint16_t frame_crc(const uint8_t *payload, uint8_t length)
{
    /* The CRC goes by half bytes, with a table of 32 bytes; a table of 512 bytes is too large for an ATmega328P. */
    static const uint16_t table[16] = {
        0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
        0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF,
    };
    uint16_t crc = 0xFFFF;
    for (uint8_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc << 4) ^ table[(uint8_t)((crc >> 12) ^ (payload[i] >> 4))];
        crc = (uint16_t)(crc << 4) ^ table[(uint8_t)((crc >> 12) ^ (payload[i] & 15u))];
    }
    return crc;
}

uint8_t frame_encode(const uint8_t *payload, uint8_t length, uint8_t wire[FRAME_MAX_WIRE])
{
    uint16_t crc = frame_crc(payload, length);
    uint8_t code = 0, at = 1;
    for (uint8_t i = 0; i < length + 2u; i++) {
        uint8_t byte = i < length ? payload[i] : (i == length ? (uint8_t)crc : (uint8_t)(crc >> 8));
        if (byte) {
            wire[at++] = byte;
        } else {
            wire[code] = (uint8_t)(at - code);
            code = at++;
        }
    }
    wire[code] = (uint8_t)(at - code);
    wire[at++] = 0;
    return at;
}

static uint8_t decode(uint8_t *bytes, uint8_t length)
{
    uint8_t read = 0, written = 0;
    while (read < length) {
        uint8_t end = (uint8_t)(read + bytes[read]);
        if (end > length || bytes[read] > length)
            return 0;
        for (read++; read < end; read++)
            bytes[written++] = bytes[read];
        if (end < length)
            bytes[written++] = 0;
    }
    if (written < 3)
        return 0;
    written -= 2;
    return frame_crc(bytes, written) == (bytes[written] | (uint16_t)(bytes[written + 1] << 8)) ? written : 0;
}

uint8_t frame_take(struct frame_reader *reader, uint8_t byte)
{
    uint8_t length = reader->length, found = 0;
    if (byte) {
        if (length < sizeof reader->bytes)
            reader->bytes[reader->length++] = byte;
        else
            reader->too_long = 1;
        return 0;
    }
    if (length) {
        if (!reader->too_long)
            found = decode(reader->bytes, length);
        if (!found)
            reader->errors++;
    }
    reader->length = 0;
    reader->too_long = 0;
    return found;
}

/* Random bytes, true frames and flipped bits into the core: for the address and undefined-behaviour sanitizers.
 *
 * Every frame that the handle sends must be decoded by the same reader, and the drive must stay within its limits.
 */
#include "../core/handle.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t random_state = 88172645463325252ull;

static uint32_t next_random(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 16);
}

static struct frame_reader listener;
static uint32_t sent, understood;

static void check_sent(void *board, const uint8_t *wire, uint8_t length)
{
    (void)board;
    sent++;
    for (uint8_t i = 0; i < length; i++)
        understood += frame_take(&listener, wire[i]) != 0;
}

static uint8_t make_frame(uint16_t session, uint8_t *wire)
{
    static const uint8_t types[] = {0x01, 0x02, 0x10, 0x10, 0x10, 0x1F, 0x55};
    uint8_t payload[FRAME_MAX_PAYLOAD], length = (uint8_t)(1 + next_random() % FRAME_MAX_PAYLOAD);
    for (uint8_t i = 0; i < sizeof payload; i++)
        payload[i] = (uint8_t)next_random();
    payload[0] = types[next_random() % sizeof types];
    if (next_random() % 8) {
        payload[4] = (uint8_t)session;
        payload[5] = (uint8_t)(session >> 8);
        if (payload[0] == 0x10)
            payload[6] = (uint8_t)(next_random() % 3);
        if (payload[0] == 0x02) {
            payload[6] = 20;
            payload[7] = 0;
            payload[11] |= 0x80;                                     /* travel_min < 0 */
            payload[15] &= 0x7F;                                     /* the others > 0 */
            payload[19] &= 0x7F;
            payload[23] &= 0x7F;
            payload[27] &= 0x7F;
            payload[31] &= 0x7F;
        }
        if (length < 40)
            length = 40;
    }
    return frame_encode(payload, length, wire);
}

int main(int argc, char **argv)
{
    uint32_t wanted = argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 10) : 1000000, given = 0, ticks = 0, driven = 0;
    struct handle_identity identity = {0};
    struct handle handle;
    identity.flags = HAS_POSITION_MODE | HAS_FORCE_MODE | FORCE_IS_ESTIMATED;
    identity.session = 0xBEEF;
    identity.max_rate_hz = 1000;
    handle_init(&handle, &identity, check_sent, NULL);
    while (given < wanted) {
        uint8_t wire[FRAME_MAX_WIRE], length = sizeof wire;
        struct handle_sample sample;
        if (next_random() % 4 == 0) {
            for (uint8_t i = 0; i < length; i++)
                wire[i] = (uint8_t)next_random();
        } else {
            length = make_frame(identity.session, wire);
            if (next_random() % 8 == 0)
                wire[next_random() % length] ^= (uint8_t)(1u << (next_random() % 8));
        }
        for (uint8_t i = 0; i < length; i++)
            handle_receive(&handle, wire[i]);
        given += length;
        memset(&sample, 0, sizeof sample);
        sample.time_us = next_random();
        sample.position = (int32_t)next_random();
        sample.force = (int32_t)next_random();
        sample.flags = next_random() % 64 ? 0 : (uint8_t)next_random();
        handle_tick(&handle, &sample);
        ticks++;
        driven += handle.drive != 0;
        if (handle.drive > handle.limits.max_drive || handle.drive < -handle.limits.max_drive
            || (handle.drive && (handle.tripped || handle.estop || !handle.configured))) {
            printf("drive %ld at tick %lu breaks its limits\n", (long)handle.drive, (unsigned long)ticks);
            return 1;
        }
    }
    printf("bytes %lu ticks %lu driven %lu sent %lu understood %lu\n", (unsigned long)given, (unsigned long)ticks,
           (unsigned long)driven, (unsigned long)sent, (unsigned long)understood);
    return !(sent > 0 && sent == understood && driven > 0);
}

/* The core as a shared library, for an emulated handle and for tests; the caller provides time, plant and line. */
#include "../../core/handle.h"

#include <stdlib.h>
#include <string.h>

#define BUFFER 8192

struct emulated {
    struct handle handle;
    uint8_t out[BUFFER];
    uint32_t length;
};

static void queue(void *board, const uint8_t *wire, uint8_t length)
{
    struct emulated *emulated = board;
    /* Bytes that do not fit are lost, as on a UART without a listener. */
    if (emulated->length + length <= BUFFER) {
        memcpy(emulated->out + emulated->length, wire, length);
        emulated->length += length;
    }
}

struct emulated *emulated_new(uint64_t device_id, uint16_t session, uint8_t flags, uint8_t reset_cause,
                              float m_per_count, float n_per_count, float drive_n_per_count, const char *model)
{
    struct emulated *emulated = calloc(1, sizeof *emulated);
    struct handle_identity identity;
    if (!emulated)
        return NULL;
    memset(&identity, 0, sizeof identity);
    identity.flags = flags;
    identity.device_id = device_id;
    identity.session = session;
    identity.max_rate_hz = 1000;
    identity.m_per_count = m_per_count;
    identity.n_per_count = n_per_count;
    identity.drive_n_per_count = drive_n_per_count;
    identity.reset_cause = reset_cause;
    memcpy(identity.model, model, strlen(model) < sizeof identity.model ? strlen(model) : sizeof identity.model);
    handle_init(&emulated->handle, &identity, queue, emulated);
    return emulated;
}

void emulated_free(struct emulated *emulated) { free(emulated); }

void emulated_receive(struct emulated *emulated, const uint8_t *bytes, uint32_t length)
{
    for (uint32_t i = 0; i < length; i++)
        handle_receive(&emulated->handle, bytes[i]);
}

/* Returns the drive [counts] until the next tick. */
int32_t emulated_tick(struct emulated *emulated, uint32_t time_us, int32_t position, int32_t force,
                      int32_t sensed_drive, int16_t supply_10mv, uint8_t flags)
{
    struct handle_sample sample = {time_us, position, force, sensed_drive, supply_10mv, flags};
    handle_tick(&emulated->handle, &sample);
    return emulated->handle.drive;
}

/* Copies the bytes that the handle has sent since the last call; returns their number. */
uint32_t emulated_sent(struct emulated *emulated, uint8_t *bytes, uint32_t room)
{
    uint32_t length = emulated->length < room ? emulated->length : room;
    memcpy(bytes, emulated->out, length);
    memmove(emulated->out, emulated->out + length, emulated->length - length);
    emulated->length -= length;
    return length;
}

uint8_t emulated_mode(const struct emulated *emulated) { return emulated->handle.mode; }
uint8_t emulated_tripped(const struct emulated *emulated) { return emulated->handle.tripped; }
uint8_t emulated_session_runs(const struct emulated *emulated) { return emulated->handle.session_runs; }
uint16_t emulated_errors(const struct emulated *emulated)
{
    return (uint16_t)(emulated->handle.reader.errors + emulated->handle.refused);
}
uint32_t emulated_encode(const uint8_t *payload, uint8_t length, uint8_t *wire) { return frame_encode(payload, length, wire); }

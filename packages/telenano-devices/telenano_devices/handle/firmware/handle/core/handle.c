#include "handle.h"

#include <string.h>

enum { ASK = 0x01, CONFIG = 0x02, COMMAND = 0x10, STOP = 0x1F, HELLO = 0x81, CONFIGURED = 0x82, STATE = 0x90 };
enum { ASK_BYTES = 12, CONFIG_BYTES = 32, COMMAND_BYTES = 16, STOP_BYTES = 6, HELLO_BYTES = 52, STATE_BYTES = 36 };

#define TICKS_A_SECOND 1000
/* Period of STATE without commands [ms]. */
#define STATE_EVERY_MS 10

static uint16_t get16(const uint8_t *at) { return (uint16_t)(at[0] | ((uint16_t)at[1] << 8)); }

static uint32_t get32(const uint8_t *at) { return get16(at) | ((uint32_t)get16(at + 2) << 16); }

static int32_t get_signed(const uint8_t *at)
{
    uint32_t bits = get32(at);
    int32_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t *at, uint32_t value)
{
    put16(at, (uint16_t)value);
    put16(at + 2, (uint16_t)(value >> 16));
}

static void put_float(uint8_t *at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put32(at, bits);
}

static int32_t clamp(int64_t value, int32_t low, int32_t high)
{
    return value < low ? low : value > high ? high : (int32_t)value;
}

/* Returns value / 2^bits, rounded towards zero; a 64-bit division takes thousands of cycles on an 8-bit processor. */
static int64_t divided(int64_t value, uint8_t bits)
{
    return value < 0 ? -(int64_t)((uint64_t)-value >> bits) : (int64_t)((uint64_t)value >> bits);
}

static void send(struct handle *handle, uint8_t *payload, uint8_t type, uint8_t flags, uint8_t length)
{
    uint8_t wire[FRAME_MAX_WIRE];
    payload[0] = type;
    payload[1] = flags;
    put16(payload + 2, handle->seq++);
    handle->send(handle->board, wire, frame_encode(payload, length, wire));
}

static void send_hello(struct handle *handle, uint16_t nonce)
{
    const struct handle_identity *identity = &handle->identity;
    uint8_t payload[FRAME_MAX_PAYLOAD] = {0};
    payload[4] = HANDLE_MAJOR;
    payload[5] = HANDLE_MINOR;
    put16(payload + 6, nonce);
    put32(payload + 8, (uint32_t)identity->device_id);
    put32(payload + 12, (uint32_t)(identity->device_id >> 32));
    put16(payload + 16, identity->session);
    put16(payload + 18, identity->max_rate_hz);
    put_float(payload + 20, identity->m_per_count);
    put_float(payload + 24, identity->n_per_count);
    put_float(payload + 28, identity->drive_n_per_count);
    put16(payload + 32, HANDLE_FIRMWARE);
    payload[34] = identity->reset_cause;
    memcpy(payload + 36, identity->model, sizeof identity->model);
    send(handle, payload, HELLO, identity->flags, HELLO_BYTES);
}

static void send_limits(struct handle *handle)
{
    const struct handle_limits *limits = &handle->limits;
    uint8_t payload[FRAME_MAX_PAYLOAD] = {0};
    put16(payload + 4, handle->identity.session);
    put16(payload + 6, limits->watchdog_ms);
    put32(payload + 8, (uint32_t)limits->travel_min);
    put32(payload + 12, (uint32_t)limits->travel_max);
    put32(payload + 16, (uint32_t)limits->max_speed);
    put32(payload + 20, (uint32_t)limits->max_drive);
    put32(payload + 24, (uint32_t)limits->servo_gain_q16);
    put32(payload + 28, (uint32_t)limits->servo_damping_q16);
    send(handle, payload, CONFIGURED, 0, CONFIG_BYTES);
}

static void send_state(struct handle *handle)
{
    const struct handle_sample *sample = &handle->sample;
    uint8_t payload[FRAME_MAX_PAYLOAD] = {0};
    uint8_t flags = sample->flags & (AT_MIN | AT_MAX | VOLTAGE_LIMITED | CURRENT_LIMITED | FORCE_SATURATED);
    flags |= handle->configured ? IS_CONFIGURED : 0;
    flags |= handle->tripped ? WATCHDOG_TRIPPED : 0;
    flags |= handle->estop ? ESTOP_PRESSED : 0;
    flags |= handle->voltage_limited ? VOLTAGE_LIMITED : 0;
    handle->unsent_ms = 0;
    put16(payload + 4, handle->command_seq);
    payload[6] = handle->mode;
    put32(payload + 8, sample->time_us);
    put32(payload + 12, (uint32_t)sample->position);
    put32(payload + 16, (uint32_t)handle->velocity);
    put32(payload + 20, (uint32_t)sample->force);
    put32(payload + 24, (uint32_t)(handle->identity.flags & SENSES_CURRENT ? sample->sensed_drive : handle->drive));
    put16(payload + 28, (uint16_t)sample->supply_10mv);
    put16(payload + 30, handle->overruns);
    put16(payload + 32, (uint16_t)(handle->reader.errors + handle->refused));
    put16(payload + 34, handle->identity.session);
    send(handle, payload, STATE, flags, STATE_BYTES);
}

static void switch_off(struct handle *handle)
{
    handle->mode = MODE_OFF;
    handle->drive = 0;
    handle->reference = 0;
}

static void configure(struct handle *handle, const uint8_t *payload)
{
    struct handle_limits limits;
    limits.watchdog_ms = get16(payload + 6);
    limits.travel_min = get_signed(payload + 8);
    limits.travel_max = get_signed(payload + 12);
    limits.max_speed = get_signed(payload + 16);
    limits.max_drive = get_signed(payload + 20);
    limits.servo_gain_q16 = get_signed(payload + 24);
    limits.servo_damping_q16 = get_signed(payload + 28);
    /* Impossible limits change nothing; the answer then has the limits in force. */
    if (limits.watchdog_ms >= 5 && limits.watchdog_ms <= 100 && limits.travel_min < limits.travel_max
        && limits.max_speed > 0 && limits.max_drive > 0 && limits.servo_gain_q16 >= 0 && limits.servo_damping_q16 >= 0) {
        handle->limits = limits;
        handle->configured = 1;
        /* A pressed e-stop latches again at the next tick. */
        handle->estop = 0;
        switch_off(handle);
    } else {
        handle->refused++;
    }
    send_limits(handle);
}

static uint8_t has_mode(const struct handle *handle, uint8_t mode)
{
    return mode == MODE_OFF || (mode == MODE_POSITION && (handle->identity.flags & HAS_POSITION_MODE))
        || (mode == MODE_FORCE && (handle->identity.flags & HAS_FORCE_MODE));
}

static void command(struct handle *handle, const uint8_t *payload)
{
    uint8_t mode = payload[6];
    if (!handle->configured || !has_mode(handle, mode) || (mode != MODE_OFF && !handle->has_sample)) {
        handle->refused++;
        return;
    }
    handle->command_seq = get16(payload + 2);
    handle->session_runs = payload[1] & 1u;
    handle->silent_ms = 0;
    if (mode == MODE_OFF) {
        handle->tripped = 0;
        switch_off(handle);
    } else if (!handle->tripped && !handle->estop) {
        if (mode == MODE_POSITION) {
            handle->wanted = clamp(get_signed(payload + 8), handle->limits.travel_min, handle->limits.travel_max);
            /* The reference begins at the position of the arm, for any command before. */
            if (handle->mode != MODE_POSITION)
                handle->reference = handle->sample.position;
        } else {
            handle->wanted = clamp(get_signed(payload + 12), -handle->limits.max_drive, handle->limits.max_drive);
        }
        handle->mode = mode;
    }
    send_state(handle);
}

static void act(struct handle *handle, const uint8_t *payload, uint8_t length)
{
    uint8_t type = payload[0];
    if (type == ASK && length >= ASK_BYTES) {
        send_hello(handle, get16(payload + 6));
        return;
    }
    if (length < STOP_BYTES || get16(payload + 4) != handle->identity.session) {
        handle->refused++;
    } else if (type == CONFIG && length >= CONFIG_BYTES) {
        configure(handle, payload);
    } else if (type == COMMAND && length >= COMMAND_BYTES) {
        command(handle, payload);
    } else if (type == STOP) {
        handle->configured = 0;
        switch_off(handle);
    } else {
        handle->refused++;
    }
}

void handle_init(struct handle *handle, const struct handle_identity *identity,
                 void (*send_bytes)(void *board, const uint8_t *wire, uint8_t length), void *board)
{
    memset(handle, 0, sizeof *handle);
    handle->identity = *identity;
    handle->send = send_bytes;
    handle->board = board;
}

void handle_receive(struct handle *handle, uint8_t byte)
{
    uint8_t length = frame_take(&handle->reader, byte);
    if (length)
        act(handle, handle->reader.bytes, length);
}

static void follow(struct handle *handle)
{
    const struct handle_limits *limits = &handle->limits;
    int64_t drive, reach = limits->max_speed / TICKS_A_SECOND + (limits->max_speed % TICKS_A_SECOND != 0);
    if (handle->mode == MODE_FORCE) {
        handle->reference = handle->wanted;
        drive = handle->wanted;
    } else {
        int64_t step = (int64_t)handle->wanted - handle->reference;
        step = step > reach ? reach : step < -reach ? -reach : step;
        handle->reference = clamp(handle->reference + step, limits->travel_min, limits->travel_max);
        /* Each product is below 2^63, because differences are below 2^32 and gains below 2^31. */
        drive = ((int64_t)handle->reference - handle->sample.position) * limits->servo_gain_q16;
        drive = divided(drive, 16) - divided((int64_t)handle->velocity * limits->servo_damping_q16, 16);
    }
    handle->drive = clamp(drive, -limits->max_drive, limits->max_drive);
    handle->voltage_limited = handle->drive != drive;
    /* Beyond the end of the travel, force mode must not push further. */
    if ((handle->sample.position >= limits->travel_max && handle->drive > 0 && handle->mode == MODE_FORCE)
        || (handle->sample.position <= limits->travel_min && handle->drive < 0 && handle->mode == MODE_FORCE))
        handle->drive = 0;
}

void handle_tick(struct handle *handle, const struct handle_sample *sample)
{
    int64_t moved = (int64_t)sample->position - handle->sample.position;
    uint32_t elapsed_us = sample->time_us - handle->sample.time_us;
    if (handle->has_sample && elapsed_us) {
        int64_t now = moved * (int32_t)(1000000u / elapsed_us);
        /* A first-order low pass over four samples smooths the steps of the encoder. */
        handle->velocity = clamp(handle->velocity + divided(now - handle->velocity, 2), -2147483647, 2147483647);
    }
    handle->sample = *sample;
    handle->has_sample = 1;
    handle->voltage_limited = 0;
    if (handle->identity.flags & FORCE_IS_ESTIMATED)
        handle->sample.force = -handle->drive;
    if (sample->flags & ESTOP_PRESSED)
        handle->estop = 1;
    if (handle->silent_ms < 0xFFFF)
        handle->silent_ms++;
    if (handle->configured && handle->silent_ms >= handle->limits.watchdog_ms)
        handle->tripped = 1;
    if (!handle->configured || handle->tripped || handle->estop)
        switch_off(handle);
    if (handle->mode == MODE_OFF)
        handle->drive = 0;
    else
        follow(handle);
    if (++handle->unsent_ms >= STATE_EVERY_MS)
        send_state(handle);
}

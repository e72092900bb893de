/* A handle: protocol, servo, guard and watchdogs, the same on every board. C99, integers only, no allocation.
 *
 * A board calls handle_receive with each byte, and handle_tick once a millisecond with its sample; it applies
 * handle->drive, and sends the bytes that handle->send gets. Quantities are raw counts.
 */
#ifndef HANDLE_H
#define HANDLE_H

#include "frame.h"

#define HANDLE_MAJOR 1
#define HANDLE_MINOR 0
#define HANDLE_FIRMWARE 0x0100

enum handle_mode { MODE_OFF = 0, MODE_POSITION = 1, MODE_FORCE = 2 };

/* Flags of HELLO. */
enum {
    HAS_POSITION_MODE = 1, HAS_FORCE_MODE = 2, HAS_FORCE_SENSOR = 4, FORCE_IS_ESTIMATED = 8,
    HAS_ESTOP_INPUT = 16, IS_BACK_DRIVABLE = 32, SENSES_CURRENT = 64, IS_EMULATED = 128
};
/* Flags of STATE. */
enum {
    IS_CONFIGURED = 1, WATCHDOG_TRIPPED = 2, ESTOP_PRESSED = 4, AT_MIN = 8, AT_MAX = 16,
    VOLTAGE_LIMITED = 32, CURRENT_LIMITED = 64, FORCE_SATURATED = 128
};

struct handle_identity {
    uint8_t flags;
    uint64_t device_id;
    uint16_t session;
    uint16_t max_rate_hz;
    float m_per_count, n_per_count, drive_n_per_count;
    uint8_t reset_cause;
    char model[16];
};

/* The measurements of the board in a millisecond. `flags` are those of STATE that only the board knows. */
struct handle_sample {
    uint32_t time_us;
    int32_t position, force;
    int32_t sensed_drive; /* with SENSES_CURRENT: the measured drive */
    int16_t supply_10mv;
    uint8_t flags;
};

struct handle_limits {
    uint16_t watchdog_ms;
    int32_t travel_min, travel_max, max_speed, max_drive, servo_gain_q16, servo_damping_q16;
};

struct handle {
    struct handle_identity identity;
    struct handle_limits limits;
    struct handle_sample sample;
    struct frame_reader reader;
    void (*send)(void *board, const uint8_t *wire, uint8_t length);
    void *board;
    int32_t drive;      /* drive that the board has to apply until the next tick */
    int32_t velocity;   /* counts a second */
    int32_t reference;  /* reference of the present mode, after every limit */
    int32_t wanted;     /* reference of the newest command */
    uint16_t seq, command_seq, overruns, refused;
    uint16_t silent_ms, unsent_ms;
    uint8_t mode, configured, tripped, estop, voltage_limited, session_runs, has_sample;
};

void handle_init(struct handle *handle, const struct handle_identity *identity,
                 void (*send)(void *board, const uint8_t *wire, uint8_t length), void *board);
void handle_receive(struct handle *handle, uint8_t byte);
void handle_tick(struct handle *handle, const struct handle_sample *sample);

#endif

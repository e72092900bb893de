/* An emulated arm of three axes with a hand on it, behind the symbols of a vendor's library.
 *
 * m x'' + b x' + c sign(x') = u + F, in the frame of the vendor; F is the force of the hand, along one axis, and begins
 * with the session. The values of m and b are chosen, not measured. Time is that of the machine, or set by a test.
 */
#ifndef TELENANO_DOUBLE_ARM_H
#define TELENANO_DOUBLE_ARM_H

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define ARM_STEP_S 25e-6
#define ARM_LONGEST_S 0.05
#define ARM_POINTS 32
#define ARM_FAILURES 16
#define ARM_LATE 1024
#define ARM_LOOK_S 0.005

/* A hand from a test's file at one time: spring k and damper c towards the intended position `to`, and a force. */
struct hand {
    double at_s, to[3], k, c, force[3];
    int buttons, plugged;
};

struct arm {
    double mass_kg, damping, friction_n, radius_m, resolution_m;
    /* The axis of the hand, and the sign of "towards the sample" along it. */
    int hand_axis;
    double hand_sign;
    double place[3], speed[3], force[3];
    double session_s, now_s, left_s, virtual_s;
    int points;
    double time_s[ARM_POINTS], hand_n[ARM_POINTS];
    /* Faults that a test has put in. */
    double offset_m, sign, latency_s;
    /* A hand of a test instead of the session's: its force, or one that holds the arm in place. */
    double push_n;
    int pushes, held;
    int frozen, not_a_number, unplugged, uncalibrated, buttons;
    double frozen_place[3];
    char failing[ARM_FAILURES][40];
    int failure[ARM_FAILURES];
    pthread_mutex_t lock;
    /* Forces delayed by the drive, with the times at which they act; at_s is the time of the arm itself. */
    double drive_delay_s, at_s, late_at[ARM_LATE], late[ARM_LATE][3];
    int late_first, late_last;
    /* The scheduler of HD no longer calls back. */
    int stopped;
    /* The present hand with its spring and damper, and the rows of a test's file. */
    struct hand arm_of_hand, *rows;
    int row_count, row_now;
    FILE *orders;
    double looked_s;
};

static void arm_set(struct arm *a, const char *name, double value);

static double arm_clock(const struct arm *a) {
    struct timespec t;
    if (a->virtual_s >= 0.0) return a->virtual_s;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Remove the force, and all delayed forces. */
static void arm_let_go(struct arm *a) {
    memset(a->force, 0, sizeof a->force);
    a->late_first = a->late_last;
}

/* Command a force, which acts at once or after the delay of the drive. */
static void arm_drive(struct arm *a, const double force[3]) {
    int next = (a->late_last + 1) % ARM_LATE;
    if (a->drive_delay_s <= 0.0 || next == a->late_first) {
        memcpy(a->force, force, sizeof a->force);
        return;
    }
    memcpy(a->late[a->late_last], force, sizeof a->force);
    a->late_at[a->late_last] = arm_clock(a) + a->drive_delay_s;
    a->late_last = next;
}

/* Read the rows of a hand: time, position, spring, damper, force, buttons, whether the cable is in. */
static void arm_read_hand(struct arm *a, const char *path) {
    FILE *file = fopen(path, "r");
    struct hand h;
    a->row_count = a->row_now = 0;
    while (file && fscanf(file, "%lf %lf %lf %lf %lf %lf %lf %lf %lf %d %d", &h.at_s, h.to, h.to + 1, h.to + 2, &h.k,
                          &h.c, h.force, h.force + 1, h.force + 2, &h.buttons, &h.plugged) == 11) {
        if (a->row_count % 1024 == 0)
            a->rows = realloc(a->rows, (size_t)(a->row_count + 1024) * sizeof *a->rows);
        a->rows[a->row_count++] = h;
    }
    if (file) fclose(file);
}

/* Set the hand to the state that the file gives for the present time of the session. */
static void arm_follow(struct arm *a) {
    const struct hand *now, *next;
    double share;
    int i;
    if (a->row_count == 0 || a->session_s < 0.0) return;
    while (a->row_now + 1 < a->row_count && a->rows[a->row_now + 1].at_s <= a->session_s) a->row_now++;
    now = a->rows + a->row_now;
    a->arm_of_hand = *now;
    if (a->row_now + 1 < a->row_count) {
        next = now + 1;
        share = (a->session_s - now->at_s) / (next->at_s - now->at_s);
        for (i = 0; i < 3; i++) a->arm_of_hand.to[i] += share * (next->to[i] - now->to[i]);
    }
    a->pushes = 1, a->push_n = 0.0;
    a->buttons = now->buttons;
    if (a->unplugged == now->plugged) arm_set(a, "unplugged", !now->plugged);
}

/* Carry out the orders that a test has written to TELENANO_DOUBLE_ORDERS since the last look, such as "unplugged 1". */
static void arm_look(struct arm *a) {
    const char *path = getenv("TELENANO_DOUBLE_ORDERS");
    char name[40];
    double value, now = arm_clock(a);
    if (!path || now < a->looked_s + ARM_LOOK_S) return;
    a->looked_s = now;
    if (!a->orders) a->orders = fopen(path, "r");
    if (!a->orders) return;
    clearerr(a->orders);
    while (fscanf(a->orders, " %39s %lf", name, &value) == 2) arm_set(a, name, value);
}

static double arm_hand(const struct arm *a) {
    int i;
    if (a->pushes) return a->push_n;
    if (a->session_s < 0.0 || a->points == 0 || a->session_s < a->time_s[0]) return 0.0;
    for (i = 1; i < a->points; i++)
        if (a->session_s < a->time_s[i]) {
            double share = (a->session_s - a->time_s[i - 1]) / (a->time_s[i] - a->time_s[i - 1]);
            return a->hand_n[i - 1] + share * (a->hand_n[i] - a->hand_n[i - 1]);
        }
    return a->hand_n[a->points - 1];
}

static void arm_step(struct arm *a, double dt) {
    double kept = exp(-a->damping * dt / a->mass_kg);
    double given = a->damping > 0.0 ? (1.0 - kept) / a->damping : dt / a->mass_kg;
    double far = 0.0;
    int i;
    while (a->late_first != a->late_last && a->late_at[a->late_first] <= a->at_s) {
        memcpy(a->force, a->late[a->late_first], sizeof a->force);
        a->late_first = (a->late_first + 1) % ARM_LATE;
    }
    a->at_s += dt;
    arm_follow(a);
    for (i = 0; i < 3; i++) {
        const struct hand *h = &a->arm_of_hand;
        double v = a->speed[i], u = a->sign * a->force[i] + h->force[i] + h->k * (h->to[i] - a->place[i]) - h->c * v;
        double next;
        if (i == a->hand_axis) u += a->hand_sign * arm_hand(a);
        if (a->friction_n > 0.0)
            u -= v != 0.0 ? copysign(a->friction_n, v) : fmax(-a->friction_n, fmin(u, a->friction_n));
        next = kept * v + given * u;
        if (a->friction_n > 0.0 && v * next < 0.0) next = 0.0;
        if (a->held) next = v = 0.0;
        a->speed[i] = next;
        a->place[i] += dt * 0.5 * (v + next);
        far += a->place[i] * a->place[i];
    }
    if (far > a->radius_m * a->radius_m)
        for (i = 0; i < 3; i++) {
            a->place[i] *= a->radius_m / sqrt(far);
            a->speed[i] = 0.0;
        }
    if (a->session_s >= 0.0) a->session_s += dt;
}

/* Advance to the present time; after a long stall skip the lost time, unless the hand has times of its own. */
static void arm_advance(struct arm *a) {
    double now = arm_clock(a);
    if (a->now_s < 0.0) a->now_s = now;
    a->left_s += a->row_count ? now - a->now_s : fmin(now - a->now_s, ARM_LONGEST_S);
    a->now_s = now;
    a->at_s = now - a->left_s;
    for (; a->left_s >= ARM_STEP_S; a->left_s -= ARM_STEP_S) arm_step(a, ARM_STEP_S);
}

static void arm_measured(const struct arm *a, double place[3]) {
    int i;
    for (i = 0; i < 3; i++) {
        place[i] = a->frozen ? a->frozen_place[i] : a->place[i];
        if (a->resolution_m > 0.0) place[i] = a->resolution_m * round(place[i] / a->resolution_m);
    }
    place[a->hand_axis] += a->offset_m;
    if (a->not_a_number) place[a->hand_axis] = NAN;
}

/* Return the error with which a test lets this call fail, 0 for none. */
static int arm_failure(const struct arm *a, const char *call) {
    int i;
    for (i = 0; i < ARM_FAILURES; i++)
        if (a->failure[i] && strcmp(a->failing[i], call) == 0) return a->failure[i];
    return 0;
}

static void arm_fail(struct arm *a, const char *call, int error) {
    int i;
    for (i = 0; i < ARM_FAILURES; i++)
        if (!a->failing[i][0] || strcmp(a->failing[i], call) == 0) {
            strncpy(a->failing[i], call, sizeof a->failing[i] - 1);
            a->failure[i] = error;
            return;
        }
}

static void arm_set(struct arm *a, const char *name, double value) {
    if (!strcmp(name, "virtual_s")) a->virtual_s = value;
    if (!strcmp(name, "offset_m")) a->offset_m = value;
    if (!strcmp(name, "sign")) a->sign = value;
    if (!strcmp(name, "latency_s")) a->latency_s = value;
    if (!strcmp(name, "frozen")) {
        a->frozen = value != 0.0;
        memcpy(a->frozen_place, a->place, sizeof a->place);
    }
    if (!strcmp(name, "not_a_number")) a->not_a_number = value != 0.0;
    if (!strcmp(name, "unplugged")) {
        a->unplugged = value != 0.0;
        if (a->unplugged) arm_let_go(a);
    }
    if (!strcmp(name, "uncalibrated")) a->uncalibrated = value != 0.0;
    if (!strcmp(name, "buttons")) a->buttons = (int)value;
    if (!strcmp(name, "session")) a->session_s = value != 0.0 ? (a->session_s < 0.0 ? 0.0 : a->session_s) : -1.0;
    if (!strcmp(name, "push_n")) a->push_n = value, a->pushes = 1;
    if (!strcmp(name, "held")) a->held = value != 0.0;
    if (!strcmp(name, "drive_delay_s")) a->drive_delay_s = value;
    if (!strcmp(name, "stopped")) a->stopped = value != 0.0;
    /* An ordinary arm whose intended position is this far towards the sample. */
    if (!strcmp(name, "hand_m")) {
        memset(&a->arm_of_hand, 0, sizeof a->arm_of_hand);
        a->arm_of_hand.to[a->hand_axis] = a->hand_sign * value;
        a->arm_of_hand.k = 300.0, a->arm_of_hand.c = 5.0;
        a->pushes = 1, a->push_n = 0.0;
    }
    if (!strcmp(name, "loose")) a->arm_of_hand.k = a->arm_of_hand.c = 0.0;
    if (!strcmp(name, "place")) a->place[a->hand_axis] = value;
}

static double arm_get(const struct arm *a, const char *name) {
    if (!strcmp(name, "place")) return a->place[a->hand_axis];
    if (!strcmp(name, "force")) return a->force[a->hand_axis];
    if (!strcmp(name, "force_size"))
        return sqrt(a->force[0] * a->force[0] + a->force[1] * a->force[1] + a->force[2] * a->force[2]);
    if (!strcmp(name, "virtual_s")) return a->virtual_s;
    if (!strcmp(name, "session_s")) return a->session_s;
    return NAN;
}

static void arm_sleep(struct arm *a, double duration_s) {
    struct timespec t;
    if (a->virtual_s >= 0.0) {
        a->virtual_s += duration_s;
        return;
    }
    t.tv_sec = (time_t)duration_s;
    t.tv_nsec = (long)(1e9 * (duration_s - (double)t.tv_sec));
    nanosleep(&t, NULL);
}

/* Read the file of a hand that TELENANO_DOUBLE_HAND names, for rigs that are started as a whole. */
static void arm_begin(struct arm *a) {
    const char *path = getenv("TELENANO_DOUBLE_HAND");
    if (path && !a->rows) arm_read_hand(a, path);
}

/* The hand of Fig. 12. */
#define ARM_FIG12 6, {0.8, 1.2, 2.6, 2.9, 4.5, 4.6}, {0.0, 1.0, 1.0, 2.0, 2.0, 0.0}

#endif

/* The symbols of Force Dimension's DHD that the driver calls, with an emulated omega.3 behind them.
 *
 * It follows the published descriptions of the calls: they return 0 or a positive code on success, and -1 on failure,
 * with the reason in dhdErrorGetLast. +X is towards the person, +Y to the right, +Z up. The watchdog, if set, removes
 * the force.
 */
#include <stdio.h>

#include "arm.h"

enum { E_NONE = 0, E_ERROR = 1, E_COM = 2, E_NO_DEVICE = 5, E_TIMEOUT = 7, E_EXPERT = 9, E_NOT_READY = 12,
       E_INVALID_INDEX = 15, E_NULL = 17, E_NOT_ENABLED = 19, E_IN_USE = 20, E_INVALID = 21 };
static const char *const texts[] = {
    "no error", "undocumented error", "communication error", "DHC controller is busy", "no driver found",
    "no device found", "feature not available", "timeout", "device geometry error", "expert mode is disabled",
    "feature not implemented", "out of memory", "device is not ready", "file not found", "wrong configuration",
    "index is not valid", "function is deprecated", "null argument", "redundant encoders disagree", "not enabled",
    "device is in use", "value is not valid", "no regulation"};

static struct arm a = {0.25, 0.50, 0.0, 0.075, 1e-6, 2, -1.0, {0}, {0}, {0}, -1.0, -1.0, 0.0, -1.0, ARM_FIG12,
                       0.0, 1.0, 0.0, 0.0, 0, 0, 0, 0, 0, 0, 0, {0}, {{0}}, {0}, PTHREAD_MUTEX_INITIALIZER,
                       .drive_delay_s = 0.0};
static __thread int last;
static int opened, expert, enabled, cause;
static double watchdog_s, commanded_s = -1.0, max_n = -1.0, counted_from_s;
static long sets;

/* Apply the device's own watchdog. */
static void watched(void) {
    if (watchdog_s > 0.0 && commanded_s >= 0.0 && arm_clock(&a) - commanded_s > watchdog_s) {
        arm_let_go(&a);
        cause = 3;
    }
}

void telenano_double_set(const char *name, double value) { arm_set(&a, name, value); }
void telenano_double_fail(const char *call, int error) { arm_fail(&a, call, error); }
void telenano_double_session(int runs) { arm_set(&a, "session", runs); }
void telenano_double_hand(const char *path) { arm_read_hand(&a, path); }
double telenano_double_get(const char *name) {
    if (!strcmp(name, "watchdog_s")) return watchdog_s;
    if (!strcmp(name, "virtual_s")) return a.virtual_s;
    if (!strcmp(name, "opened")) return opened;
    arm_advance(&a);
    watched();
    return arm_get(&a, name);
}

static int failed(int error) {
    last = error;
    return error == E_NONE ? 0 : -1;
}

/* Begin a call of an open device: check for faults, and advance the arm; returns 0, or -1 with `last` set. */
static int begun(const char *call, char id) {
    int error = arm_failure(&a, call);
    arm_look(&a);
    if (error) return failed(error);
    if (!opened || id != 0) return failed(E_INVALID_INDEX);
    if (a.unplugged) return failed(E_COM);
    arm_advance(&a);
    watched();
    return failed(E_NONE);
}

int dhdGetDeviceCount(void) { return a.unplugged ? 0 : 1; }
int dhdGetAvailableCount(void) {
    arm_begin(&a);
    arm_look(&a);
    arm_advance(&a);
    return arm_failure(&a, "dhdGetAvailableCount") ? -1 : a.unplugged ? 0 : 1;
}
int dhdErrorGetLast(void) { return last; }
const char *dhdErrorGetStr(int error) { return error >= 0 && error < 23 ? texts[error] : "unknown"; }
const char *dhdErrorGetLastStr(void) { return dhdErrorGetStr(last); }

int dhdOpen(void) {
    int error = arm_failure(&a, "dhdOpen");
    if (error) return failed(error);
    if (a.unplugged) return failed(E_NO_DEVICE);
    opened = 1;
    cause = enabled = expert = 0;
    commanded_s = -1.0;
    a.sign = a.sign == 0.0 ? 1.0 : a.sign;
    last = E_NONE;
    return 0;
}
int dhdOpenSerial(int serial) { return serial == 4711 ? dhdOpen() : failed(E_NO_DEVICE); }
int dhdClose(char id) {
    if (begun("dhdClose", id) < 0) return -1;
    opened = 0;
    return 0;
}
int dhdStop(char id) {
    if (begun("dhdStop", id) < 0) return -1;
    arm_let_go(&a);
    enabled = 0;
    return 0;
}
int dhdGetSystemType(char id) { return begun("dhdGetSystemType", id) < 0 ? -1 : 33; }
const char *dhdGetSystemName(char id) { return begun("dhdGetSystemName", id) < 0 ? NULL : "omega.3"; }
int dhdGetSerialNumber(unsigned short *serial, char id) {
    if (begun("dhdGetSerialNumber", id) < 0) return -1;
    *serial = 4711;
    return 0;
}
void dhdGetSDKVersion(int *major, int *minor, int *release, int *revision) {
    *major = 3, *minor = 17, *release = 0, *revision = 0;
}
int dhdGetPosition(double *x, double *y, double *z, char id) {
    double place[3];
    if (a.latency_s > 0.0) arm_sleep(&a, a.latency_s);
    if (begun("dhdGetPosition", id) < 0) return -1;
    arm_measured(&a, place);
    *x = place[0], *y = place[1], *z = place[2];
    return 0;
}
int dhdGetOrientationFrame(double frame[3][3], char id) {
    int i, j;
    if (begun("dhdGetOrientationFrame", id) < 0) return -1;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) frame[i][j] = i == j;
    return 0;
}
unsigned int dhdGetButtonMask(char id) { return begun("dhdGetButtonMask", id) < 0 ? 0u : (unsigned int)a.buttons; }
int dhdSetForce(double x, double y, double z, char id) {
    double size = sqrt(x * x + y * y + z * z), kept;
    if (begun("dhdSetForce", id) < 0) return -1;
    if (!isfinite(size)) return failed(E_INVALID);
    if (!enabled) return failed(E_NOT_ENABLED);
    kept = max_n >= 0.0 && size > max_n ? max_n / size : 1.0;
    arm_drive(&a, (double[3]){kept * x, kept * y, kept * z});
    commanded_s = arm_clock(&a);
    cause = 0;
    sets++;
    return kept < 1.0 ? 2 : 0;
}
int dhdEnableForce(unsigned char on, char id) {
    if (begun("dhdEnableForce", id) < 0) return -1;
    enabled = on;
    if (!on) arm_let_go(&a);
    return 0;
}
int dhdSetGravityCompensation(int on, char id) { (void)on; return begun("dhdSetGravityCompensation", id); }
int dhdSetMaxForce(double most, char id) {
    if (begun("dhdSetMaxForce", id) < 0) return -1;
    max_n = most;
    return 0;
}
int dhdEnableExpertMode(void) { return arm_failure(&a, "dhdEnableExpertMode") ? -1 : (expert = 1, 0); }
int dhdDisableExpertMode(void) { return expert = 0; }
int dhdSetWatchdog(unsigned char steps, char id) {
    if (begun("dhdSetWatchdog", id) < 0) return -1;
    if (!expert) return failed(E_EXPERT);
    watchdog_s = steps * 125e-6;
    return 0;
}
int dhdSetTimeGuard(int us, char id) {
    (void)us;
    if (begun("dhdSetTimeGuard", id) < 0) return -1;
    return expert ? 0 : failed(E_EXPERT);
}
double dhdGetComFreq(char id) {
    double now = arm_clock(&a), khz = now > counted_from_s ? 1e-3 * (double)sets / (now - counted_from_s) : 0.0;
    if (begun("dhdGetComFreq", id) < 0) return 0.0;
    sets = 0, counted_from_s = now;
    return khz;
}
int dhdGetStatus(int status[17], char id) {
    if (begun("dhdGetStatus", id) < 0) return -1;
    memset(status, 0, 17 * sizeof *status);
    status[0] = status[1] = status[2] = 1;
    status[3] = a.uncalibrated;
    status[5] = enabled && !cause;
    status[14] = cause;
    return 0;
}

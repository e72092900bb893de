/* The symbols of OpenHaptics' libHD that the driver calls, with an emulated Touch behind them.
 *
 * It follows the published descriptions: a scheduler with a thread of its own calls back 500 or 1000 times a second,
 * positions are in mm and speeds in mm/s, +X is to the right, +Y up and +Z towards the person, and errors are on a
 * stack that hdGetError pops.
 */
#include "arm.h"

typedef unsigned int HHD;
typedef struct { unsigned int errorCode; int internalErrorCode; HHD hHD; } HDErrorInfo;
typedef unsigned int (*callback)(void *);

enum { BUTTONS = 0x2000, POSITION = 0x2050, VELOCITY = 0x2051, TRANSFORM = 0x2052, MODEL = 0x2501, VENDOR = 0x2503,
       SERIAL = 0x2504, USABLE = 0x2551, STYLE = 0x2555, STIFFNESS = 0x2602, MAX_FORCE = 0x2603, CONTINUOUS = 0x2604,
       DAMPING = 0x2609, RATE = 0x2600, FORCE = 0x2700, FORCE_OUTPUT = 0x4000, CALIBRATED = 0x5000, MANUAL = 0x5002 };
enum { BAD_ENUM = 0x0100, BAD_VALUE = 0x0101, BAD_OPERATION = 0x0102, BAD_HANDLE = 0x0104, MAX_FORCE_ERROR = 0x0201,
       DEVICE_FAULT = 0x0300, COMM = 0x0302, ILLEGAL_BEGIN = 0x0400, ILLEGAL_END = 0x0401, FRAME = 0x0402 };
#define INVALID 0xFFFFFFFFu
#define STACK 16

static struct arm a = {0.045, 0.05, 0.0, 0.075, 0.055e-3, 1, -1.0, {0}, {0}, {0}, -1.0, -1.0, 0.0, -1.0, ARM_FIG12,
                       0.0, 1.0, 0.0, 0.0, 0, 0, 0, 0, 0, 0, 0, {0}, {{0}}, {0}, PTHREAD_MUTEX_INITIALIZER,
                       .drive_delay_s = 0.0};
static HDErrorInfo stack[STACK];
static int errors, inited, forces_on, in_frame, runs;
static double asked[3];
static unsigned long rate_hz = 1000;
static callback called;
static void *data;
static pthread_t thread;

void telenano_double_set(const char *name, double value) { arm_set(&a, name, value); }
void telenano_double_fail(const char *call, int error) { arm_fail(&a, call, error); }
void telenano_double_session(int on) { arm_set(&a, "session", on); }
void telenano_double_hand(const char *path) { arm_read_hand(&a, path); }
double telenano_double_get(const char *name) {
    if (!strcmp(name, "virtual_s")) return a.virtual_s;
    if (!strcmp(name, "opened")) return inited;
    if (!strcmp(name, "forces_on")) return forces_on;
    if (!strcmp(name, "rate_hz")) return (double)rate_hz;
    if (!runs) arm_advance(&a);
    return arm_get(&a, name);
}

static void push(unsigned int code) {
    HDErrorInfo info = {code, 0, 0};
    if (errors < STACK) stack[errors++] = info;
}
static int begun(const char *call) {
    int error = arm_failure(&a, call);
    arm_look(&a);
    if (!error && !inited) error = BAD_HANDLE;
    if (!error && a.unplugged) error = COMM;
    if (error) push((unsigned int)error);
    return !error;
}

HDErrorInfo hdGetError(void) {
    HDErrorInfo none = {0, 0, INVALID};
    return errors ? stack[--errors] : none;
}
const char *hdGetErrorString(unsigned int code) {
    switch (code) {
        case 0: return "No error";
        case BAD_ENUM: return "Invalid enumeration";
        case BAD_VALUE: return "Invalid value";
        case BAD_OPERATION: return "Invalid operation";
        case BAD_HANDLE: return "Bad handle";
        case MAX_FORCE_ERROR: return "Exceeded maximum force";
        case DEVICE_FAULT: return "Device fault";
        case COMM: return "Communication error with device";
        case ILLEGAL_BEGIN: return "Illegal begin frame";
        case ILLEGAL_END: return "Illegal end frame";
        case FRAME: return "Frame error";
        default: return "Unknown error";
    }
}
HHD hdInitDevice(const char *name) {
    int error = arm_failure(&a, "hdInitDevice");
    arm_begin(&a);
    arm_look(&a);
    if (!runs) arm_advance(&a);
    if (a.unplugged) error = COMM;
    if (name && strcmp(name, "Default Device")) error = DEVICE_FAULT;
    if (error) {
        push((unsigned int)error);
        return INVALID;
    }
    inited = 1;
    forces_on = in_frame = 0;
    return 0;
}
void hdDisableDevice(HHD device) {
    (void)device;
    inited = forces_on = 0;
    arm_let_go(&a);
}
HHD hdGetCurrentDevice(void) { return inited ? 0 : INVALID; }
void hdMakeCurrentDevice(HHD device) { if (device != 0) push(BAD_HANDLE); }
void hdEnable(unsigned int capability) {
    if (!begun("hdEnable")) return;
    if (capability == FORCE_OUTPUT) forces_on = 1;
}
void hdDisable(unsigned int capability) {
    if (!begun("hdDisable")) return;
    if (capability == FORCE_OUTPUT) forces_on = 0;
    arm_let_go(&a);
}
unsigned int hdCheckCalibration(void) { return a.uncalibrated ? MANUAL : CALIBRATED; }
void hdUpdateCalibration(unsigned int style) { (void)style; begun("hdUpdateCalibration"); }
void hdBeginFrame(HHD device) {
    (void)device;
    if (a.latency_s > 0.0) arm_sleep(&a, a.latency_s);
    if (!begun("hdBeginFrame")) return;
    if (in_frame) push(ILLEGAL_BEGIN);
    in_frame = 1;
    arm_advance(&a);
    memset(asked, 0, sizeof asked);
}
void hdEndFrame(HHD device) {
    (void)device;
    if (!begun("hdEndFrame")) {
        in_frame = 0;
        return;
    }
    if (!in_frame) push(ILLEGAL_END);
    in_frame = 0;
    if (forces_on) arm_drive(&a, asked);
}
void hdGetDoublev(unsigned int what, double *out) {
    int i;
    if (!begun("hdGetDoublev")) return;
    if (what == POSITION) {
        if (!in_frame) { push(FRAME); return; }
        arm_measured(&a, out);
        for (i = 0; i < 3; i++) out[i] *= 1e3;
    } else if (what == TRANSFORM) {
        for (i = 0; i < 16; i++) out[i] = i % 5 == 0;
        arm_measured(&a, out + 12);
        for (i = 12; i < 15; i++) out[i] *= 1e3;
    } else if (what == USABLE) {
        static const double ends[6] = {-80, -60, -35, 80, 60, 35};
        memcpy(out, ends, sizeof ends);
    } else if (what == MAX_FORCE) *out = 3.3;
    else if (what == CONTINUOUS) *out = 0.88;
    else if (what == STIFFNESS) *out = 0.5;
    else if (what == DAMPING) *out = 0.004;
    else push(BAD_ENUM);
}
void hdGetIntegerv(unsigned int what, int *out) {
    if (!begun("hdGetIntegerv")) return;
    if (what == BUTTONS) *out = a.buttons;
    else if (what == STYLE) *out = 4;
    else if (what == RATE) *out = (int)rate_hz;
    else push(BAD_ENUM);
}
const char *hdGetString(unsigned int what) {
    if (!begun("hdGetString")) return "";
    return what == MODEL ? "Touch" : what == VENDOR ? "telenano double" : what == SERIAL ? "0815" : "";
}
void hdSetDoublev(unsigned int what, const double *value) {
    double size = sqrt(value[0] * value[0] + value[1] * value[1] + value[2] * value[2]);
    if (!begun("hdSetDoublev")) return;
    if (what != FORCE) push(BAD_ENUM);
    else if (!in_frame) push(FRAME);
    else if (!isfinite(size)) push(BAD_VALUE);
    else if (size > 3.3) push(MAX_FORCE_ERROR);
    else memcpy(asked, value, sizeof asked);
}

static void *serve(void *unused) {
    struct timespec due;
    (void)unused;
    clock_gettime(CLOCK_MONOTONIC, &due);
    while (runs) {
        if (a.stopped) arm_look(&a), arm_advance(&a);
        else if (called && called(data) == 0) called = NULL;
        due.tv_nsec += (long)(1000000000ul / rate_hz);
        if (due.tv_nsec >= 1000000000l) due.tv_sec++, due.tv_nsec -= 1000000000l;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
    }
    return NULL;
}
unsigned long hdScheduleAsynchronous(callback function, void *argument, unsigned short priority) {
    (void)priority;
    if (!begun("hdScheduleAsynchronous")) return 0;
    called = function, data = argument;
    return 1;
}
void hdUnschedule(unsigned long handle) { (void)handle; called = NULL; }
void hdSetSchedulerRate(unsigned long hz) {
    if (!begun("hdSetSchedulerRate")) return;
    if (hz != 500 && hz != 1000) push(BAD_VALUE);
    else rate_hz = hz;
}
void hdStartScheduler(void) {
    if (!begun("hdStartScheduler") || runs) return;
    runs = 1;
    /* In virtual time only telenano_double_tick calls back. */
    if (a.virtual_s < 0.0 && pthread_create(&thread, NULL, serve, NULL)) runs = 0;
}
void hdStopScheduler(void) {
    if (!runs) return;
    runs = 0;
    if (a.virtual_s < 0.0) pthread_join(thread, NULL);
}
void telenano_double_tick(void) {
    if (runs && !a.stopped && called && called(data) == 0) called = NULL;
}

/* The chaser of arm_throws_and_tows.py as an FMU of its own (FMI 3.0, co-simulation): base, two-joint arm and
   reaction wheel, which know nothing of a net. two_fmus.py compiles it and writes its model description.

   Coordinates: place and quaternion of the base, angles of shoulder and elbow; speeds: velocity and angular
   velocity of the base in the scene's axes, rates of shoulder, elbow and wheel. The forces that given
   accelerations need follow from body to body (recursive Newton-Euler); with unit accelerations they are the
   columns of the mass matrix. Steps of Runge-Kutta of order 4. Units: kg, m, s, N, rad. */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>

enum { COORDINATES = 9, SPEEDS = 9, ALL = COORDINATES + SPEEDS, BODIES = 4, VARIABLES = 25 };
enum { BASE, WHEEL, UPPER, FORE };

static const double LONGEST = 2.5e-4;                     /* of its own steps [s] */
static const double THRUST[3] = {0.0, 0.0, -40.0};        /* N, on the base all the time */
static const double SWING = 2.0, LASTS = 1.5, ANGLE = M_PI / 4.0; /* the shoulder's, as in the script */
static const double STIFF = 200.0, DAMPED = 150.0;        /* of the wheel's control: N m/rad, N m s/rad */
static const double DRIVE = 5000.0, DRIVE_DAMPED = 500.0; /* of the joints: N m/rad, N m s/rad */
static const double MASS[BODIES] = {120.0, 2700.0 * M_PI * 0.09 * 0.03, 6.72, 6.72};

typedef struct {
    double y[ALL];      /* coordinates, then speeds */
    double wrench[6];   /* at the hand, in the scene's axes */
    double momentum[3]; /* by the forces from outside, which are constant over a step, to round-off */
    double offset, motor; /* of the shoulder [rad]; on the base [N m]: held over a communication step */
    double out[VARIABLES];
} Chaser;

typedef struct { /* at one instant */
    double turn[BODIES][9], spin[BODIES][3], place[BODIES][3];
    double axis[3], shoulder[3], elbow[3], hand[3];
} Shape;

static void cross(const double *a, const double *b, double *c) {
    double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    c[0] = x, c[1] = y, c[2] = z;
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void add(double *to, double factor, const double *a) {
    for (int k = 0; k < 3; k++) to[k] += factor * a[k];
}

/* from + turn * (0, y, z) */
static void along(const double *from, const double *turn, double y, double z, double *to) {
    for (int k = 0; k < 3; k++) to[k] = from[k] + turn[3 * k + 1] * y + turn[3 * k + 2] * z;
}

/* turned about the own x axis */
static void about_x(const double *turn, double angle, double *to) {
    for (int k = 0; k < 3; k++) {
        const double *row = turn + 3 * k;
        to[3 * k] = row[0];
        to[3 * k + 1] = row[1] * cos(angle) + row[2] * sin(angle);
        to[3 * k + 2] = row[2] * cos(angle) - row[1] * sin(angle);
    }
}

static void rotation(const double *q, double *r) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double all[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                     2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                     2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    for (int k = 0; k < 9; k++) r[k] = all[k];
}

static Shape shape_of(const double *y) {
    Shape s;
    const double *spin = y + 12;
    rotation(y + 3, s.turn[BASE]);
    rotation(y + 3, s.turn[WHEEL]); /* round: its own angle does not matter */
    about_x(s.turn[BASE], y[7], s.turn[UPPER]);
    about_x(s.turn[UPPER], y[8], s.turn[FORE]);
    for (int k = 0; k < 3; k++) {
        s.axis[k] = s.turn[BASE][3 * k];
        s.place[BASE][k] = s.place[WHEEL][k] = y[k];
        s.spin[BASE][k] = spin[k];
        s.spin[WHEEL][k] = spin[k] + y[17] * s.axis[k];
        s.spin[UPPER][k] = spin[k] + y[15] * s.axis[k];
        s.spin[FORE][k] = spin[k] + (y[15] + y[16]) * s.axis[k];
    }
    along(y, s.turn[BASE], 0.0, 0.55, s.shoulder);
    along(s.shoulder, s.turn[UPPER], 0.35, 0.0, s.place[UPPER]);
    along(s.shoulder, s.turn[UPPER], 0.7, 0.0, s.elbow);
    along(s.elbow, s.turn[FORE], 0.0, 0.35, s.place[FORE]);
    along(s.elbow, s.turn[FORE], 0.0, 0.7, s.hand);
    return s;
}

/* Acceleration of a point of a body from that of another: + alpha x d + omega x (omega x d) */
static void carried(const double *of, const double *from, const double *to, const double *spin,
                    const double *rate, double *result) {
    double d[3], once[3], twice[3];
    for (int k = 0; k < 3; k++) d[k] = to[k] - from[k], result[k] = of[k];
    cross(rate, d, once);
    add(result, 1.0, once);
    cross(spin, d, once);
    cross(spin, once, twice);
    add(result, 1.0, twice);
}

/* Add what a force and a torque at a point do to the speeds; on: the outermost body that they act on. */
static void act(const Shape *s, int on, const double *point, const double *force, const double *torque,
                double *speeds) {
    const double *centres[3] = {s->place[BASE], s->shoulder, s->elbow};
    for (int joint = 0; joint < 3; joint++) {
        double arm[3], moment[3];
        for (int k = 0; k < 3; k++) arm[k] = point[k] - centres[joint][k];
        cross(arm, force, moment);
        add(moment, 1.0, torque);
        if (joint == 0) add(speeds, 1.0, force), add(speeds + 3, 1.0, moment);
        if (joint == 1 && on >= UPPER) speeds[6] += dot(s->axis, moment);
        if (joint == 2 && on == FORE) speeds[7] += dot(s->axis, moment);
    }
    if (on == WHEEL) speeds[8] += dot(s->axis, torque);
}

/* The forces on the speeds that accelerations of the speeds need. */
static void needed(const Shape *s, const double *y, const double *wanted, double *speeds) {
    static const double round = 2700.0 * M_PI * 0.09 * 0.03 * (0.09 / 4.0 + 0.0009 / 12.0);
    static const double along_axis = 2700.0 * M_PI * 0.09 * 0.03 * 0.09 / 2.0;
    static const double thin = 6.72 * (0.0064 + 0.0064) / 12.0, wide = 6.72 * (0.0064 + 0.49) / 12.0;
    const double inertia[BODIES][3] = {
        {20.0, 20.0, 20.0}, {along_axis, round, round}, {wide, thin, wide}, {wide, wide, thin}};
    double rate[BODIES][3], at[BODIES][3], shoulder[3], elbow[3], turning[3];
    const double relative[BODIES] = {0.0, wanted[8], wanted[6], wanted[6] + wanted[7]};
    const double speed[BODIES] = {0.0, y[17], y[15], y[15] + y[16]};
    cross(s->spin[BASE], s->axis, turning);
    for (int b = 0; b < BODIES; b++)
        for (int k = 0; k < 3; k++)
            rate[b][k] = wanted[3 + k] + relative[b] * s->axis[k] + speed[b] * turning[k];
    for (int k = 0; k < 3; k++) at[BASE][k] = at[WHEEL][k] = wanted[k];
    carried(wanted, s->place[BASE], s->shoulder, s->spin[BASE], rate[BASE], shoulder);
    carried(shoulder, s->shoulder, s->place[UPPER], s->spin[UPPER], rate[UPPER], at[UPPER]);
    carried(shoulder, s->shoulder, s->elbow, s->spin[UPPER], rate[UPPER], elbow);
    carried(elbow, s->elbow, s->place[FORE], s->spin[FORE], rate[FORE], at[FORE]);
    for (int k = 0; k < SPEEDS; k++) speeds[k] = 0.0;
    for (int b = 0; b < BODIES; b++) {
        double force[3], own[3] = {0}, torque[3] = {0}, moment[3];
        for (int a = 0; a < 3; a++) { /* in the body's axes, then back */
            double column[3] = {s->turn[b][a], s->turn[b][3 + a], s->turn[b][6 + a]};
            add(torque, inertia[b][a] * dot(column, rate[b]), column);
            add(own, inertia[b][a] * dot(column, s->spin[b]), column);
        }
        cross(s->spin[b], own, moment);
        add(torque, 1.0, moment);
        for (int k = 0; k < 3; k++) force[k] = MASS[b] * at[b][k];
        act(s, b, s->place[b], force, torque, speeds);
    }
}

static void solve(double a[SPEEDS][SPEEDS], double *b) { /* symmetric and positive: no pivots */
    for (int i = 0; i < SPEEDS; i++)
        for (int j = i + 1; j < SPEEDS; j++) {
            double part = a[j][i] / a[i][i];
            for (int k = i; k < SPEEDS; k++) a[j][k] -= part * a[i][k];
            b[j] -= part * b[i];
        }
    for (int i = SPEEDS - 1; i >= 0; i--) {
        for (int k = i + 1; k < SPEEDS; k++) b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
}

static void rates(const Chaser *c, const double *y, double *rate) {
    Shape s = shape_of(y);
    double mass[SPEEDS][SPEEDS], at_rest[SPEEDS], column[SPEEDS], nothing[SPEEDS] = {0};
    double *force = rate + COORDINATES;
    const double *q = y + 3, *w = y + 12;
    for (int k = 0; k < 3; k++) rate[k] = y[9 + k];
    rate[3] = -0.5 * (w[0] * q[1] + w[1] * q[2] + w[2] * q[3]); /* half of (0, w) times q */
    rate[4] = 0.5 * (w[0] * q[0] + w[1] * q[3] - w[2] * q[2]);
    rate[5] = 0.5 * (w[1] * q[0] + w[2] * q[1] - w[0] * q[3]);
    rate[6] = 0.5 * (w[2] * q[0] + w[0] * q[2] - w[1] * q[1]);
    rate[7] = y[15], rate[8] = y[16];
    needed(&s, y, nothing, at_rest);
    for (int k = 0; k < SPEEDS; k++) {
        double unit[SPEEDS] = {0};
        unit[k] = 1.0;
        needed(&s, y, unit, column);
        for (int j = 0; j < SPEEDS; j++) mass[j][k] = column[j] - at_rest[j];
        force[k] = -at_rest[k];
    }
    act(&s, BASE, s.place[BASE], THRUST, nothing, force);
    act(&s, FORE, s.hand, c->wrench, c->wrench + 3, force);
    force[6] -= DRIVE * (y[7] - c->offset) + DRIVE_DAMPED * y[15];
    force[7] -= DRIVE * y[8] + DRIVE_DAMPED * y[16];
    force[8] -= c->motor;
    solve(mass, force);
}

static void step(Chaser *c, double h) {
    static const double part[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    double next[ALL], at[ALL], rate[ALL] = {0};
    for (int k = 0; k < ALL; k++) next[k] = c->y[k];
    for (int stage = 0; stage < 4; stage++) {
        for (int k = 0; k < ALL; k++) at[k] = c->y[k] + part[stage] * h * rate[k];
        rates(c, at, rate);
        for (int k = 0; k < ALL; k++) next[k] += weight[stage] * h * rate[k];
    }
    double size = sqrt(next[3] * next[3] + next[4] * next[4] + next[5] * next[5] + next[6] * next[6]);
    for (int k = 0; k < ALL; k++) c->y[k] = next[k] / (k >= 3 && k < 7 ? size : 1.0);
}

static double turned(const Chaser *c) { /* of the base about x, the first of three angles about x, y, z */
    double r[9];
    rotation(c->y + 3, r);
    return atan2(-r[5], r[8]);
}

/* Place, velocity, attitude and angular velocity of the hand, in its axes; then the wrench; then the base's
   angle, the wheel's speed and the momentum. */
static void tell(Chaser *c) {
    Shape s = shape_of(c->y);
    double *out = c->out, *momentum = c->out + 21;
    const double *joints[4] = {s.place[BASE], s.shoulder, s.elbow, s.hand};
    const double *ends[2] = {s.place[UPPER], s.place[FORE]};
    const double *spins[3] = {s.spin[BASE], s.spin[UPPER], s.spin[FORE]};
    double speed[3] = {c->y[9], c->y[10], c->y[11]}, arm[3], extra[3];
    const double *q = c->y + 3;
    double half = 0.5 * (c->y[7] + c->y[8]);
    for (int k = 0; k < 3; k++) momentum[k] = (MASS[BASE] + MASS[WHEEL]) * speed[k];
    for (int link = 0; link < 3; link++) {
        if (link > 0) {
            for (int k = 0; k < 3; k++) arm[k] = ends[link - 1][k] - joints[link][k];
            cross(spins[link], arm, extra);
            add(momentum, MASS[UPPER], speed);
            add(momentum, MASS[UPPER], extra); /* both links are alike */
        }
        for (int k = 0; k < 3; k++) arm[k] = joints[link + 1][k] - joints[link][k];
        cross(spins[link], arm, extra);
        add(speed, 1.0, extra);
    }
    for (int k = 0; k < 3; k++) {
        double column[3] = {s.turn[FORE][k], s.turn[FORE][3 + k], s.turn[FORE][6 + k]};
        out[k] = s.hand[k], out[3 + k] = speed[k], out[10 + k] = dot(column, s.spin[FORE]);
    }
    out[6] = q[0] * cos(half) - q[1] * sin(half); /* q times a turn about x */
    out[7] = q[1] * cos(half) + q[0] * sin(half);
    out[8] = q[2] * cos(half) + q[3] * sin(half);
    out[9] = q[3] * cos(half) - q[2] * sin(half);
    for (int k = 0; k < 6; k++) out[13 + k] = c->wrench[k];
    out[19] = turned(c);
    out[20] = c->y[17];
    out[24] = c->y[8];
}

/* What a host calls. */
enum { OK = 0, ERROR = 3 };

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, const unsigned *intermediate,
                                  size_t number, void *environment, void *log, void *update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)intermediate, (void)number, (void)environment, (void)log, (void)update;
    Chaser *c = calloc(1, sizeof *c);
    if (c) c->y[1] = -0.7, c->y[2] = -1.25, c->y[3] = 1.0, tell(c);
    return c;
}

void fmi3FreeInstance(void *instance) { free(instance); }
int fmi3EnterInitializationMode(void *c, bool t, double tolerance, double start, bool s, double stop) {
    (void)c, (void)t, (void)tolerance, (void)s, (void)stop;
    return start == 0.0 ? OK : ERROR;
}
int fmi3ExitInitializationMode(void *c) { return (void)c, OK; }
int fmi3Terminate(void *c) { return (void)c, OK; }

int fmi3GetFloat64(void *instance, const unsigned *which, size_t number, double *values, size_t count) {
    const Chaser *c = instance;
    for (size_t k = 0; k < number; k++) {
        if (which[k] < 1 || which[k] > VARIABLES || count != number) return ERROR;
        values[k] = c->out[which[k] - 1];
    }
    return OK;
}

int fmi3SetFloat64(void *instance, const unsigned *which, size_t number, const double *values, size_t count) {
    Chaser *c = instance;
    for (size_t k = 0; k < number; k++) {
        if (which[k] < 14 || which[k] > 19 || count != number || !isfinite(values[k])) return ERROR;
        c->wrench[which[k] - 14] = c->out[which[k] - 1] = values[k];
    }
    return OK;
}

int fmi3DoStep(void *instance, double begin, double length, bool no_return, bool *events, bool *terminate,
               bool *early, double *reached) {
    Chaser *c = instance;
    double part = fmin(fmax((begin + length - SWING) / LASTS, 0.0), 1.0);
    int number = (int)ceil(length / LONGEST * (1.0 - 1e-9));
    (void)no_return;
    if (!(length > 0.0)) return ERROR;
    c->offset = ANGLE * part * part * (3.0 - 2.0 * part);
    c->motor = -STIFF * turned(c) - DAMPED * dot((double[3]){1.0, 0.0, 0.0}, c->y + 12);
    for (int k = 0; k < number; k++) step(c, length / number);
    add(c->momentum, length, THRUST);
    add(c->momentum, length, c->wrench);
    tell(c);
    for (int k = 0; k < 3; k++) /* what the steps have missed of it, some 1e-12 m/s */
        c->y[9 + k] += (c->momentum[k] - c->out[21 + k]) / (MASS[BASE] + MASS[WHEEL] + MASS[UPPER] + MASS[FORE]);
    tell(c);
    *events = *terminate = *early = false;
    *reached = begin + length;
    return OK;
}

/* FMI asks that all functions are there. */
const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void) { return NULL; }
#define NOT_HERE(name) \
    int fmi3##name(void) { return ERROR; }
NOT_HERE(ActivateModelPartition) NOT_HERE(CompletedIntegratorStep) NOT_HERE(DeserializeFMUState)
NOT_HERE(EnterConfigurationMode) NOT_HERE(EnterContinuousTimeMode) NOT_HERE(EnterEventMode)
NOT_HERE(EnterStepMode) NOT_HERE(EvaluateDiscreteStates) NOT_HERE(ExitConfigurationMode)
NOT_HERE(FreeFMUState) NOT_HERE(GetAdjointDerivative) NOT_HERE(GetBinary) NOT_HERE(GetBoolean)
NOT_HERE(GetClock) NOT_HERE(GetContinuousStateDerivatives) NOT_HERE(GetContinuousStates)
NOT_HERE(GetDirectionalDerivative) NOT_HERE(GetEventIndicators) NOT_HERE(GetFMUState) NOT_HERE(GetFloat32)
NOT_HERE(GetInt16) NOT_HERE(GetInt32) NOT_HERE(GetInt64) NOT_HERE(GetInt8) NOT_HERE(GetIntervalDecimal)
NOT_HERE(GetIntervalFraction) NOT_HERE(GetNominalsOfContinuousStates) NOT_HERE(GetNumberOfContinuousStates)
NOT_HERE(GetNumberOfEventIndicators) NOT_HERE(GetNumberOfVariableDependencies) NOT_HERE(GetOutputDerivatives)
NOT_HERE(GetShiftDecimal) NOT_HERE(GetShiftFraction) NOT_HERE(GetString) NOT_HERE(GetUInt16)
NOT_HERE(GetUInt32) NOT_HERE(GetUInt64) NOT_HERE(GetUInt8) NOT_HERE(GetVariableDependencies) NOT_HERE(Reset)
NOT_HERE(SerializeFMUState) NOT_HERE(SerializedFMUStateSize) NOT_HERE(SetBinary) NOT_HERE(SetBoolean)
NOT_HERE(SetClock) NOT_HERE(SetContinuousStates) NOT_HERE(SetDebugLogging) NOT_HERE(SetFMUState)
NOT_HERE(SetFloat32) NOT_HERE(SetInt16) NOT_HERE(SetInt32) NOT_HERE(SetInt64) NOT_HERE(SetInt8)
NOT_HERE(SetIntervalDecimal) NOT_HERE(SetIntervalFraction) NOT_HERE(SetShiftDecimal)
NOT_HERE(SetShiftFraction) NOT_HERE(SetString) NOT_HERE(SetTime) NOT_HERE(SetUInt16) NOT_HERE(SetUInt32)
NOT_HERE(SetUInt64) NOT_HERE(SetUInt8) NOT_HERE(UpdateDiscreteStates)

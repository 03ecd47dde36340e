/* An FMU for Model Exchange in this process, asked for its equations: what equations.c, called by a run, and an export that
   carries FMUs (export/c/nested.h) have in common. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef struct rs_remote rs_remote; /* an instance in a process of its own: equations.c */

/* An instance with its parameters: sides (n_z) of its event indicators, the time of its next event. remote: null where it
   is in this process. */
typedef struct {
    void *instance;
    const double *sides;
    double due;
    rs_remote *remote;
} rs_instance;

/* What is known of a direction in p: instances on both sides of p, over a step each way. */
typedef struct {
    const double *p, *seed;
    rs_instance high, low;
    double step;
} rs_pair;

/* An instance that is asked at these p; none where p is null. */
typedef struct {
    const double *p;
    rs_instance of;
} rs_ready;

/* n: states, inputs, outputs, event indicators, parameters. timed: it may follow the time itself; guarded: an event ends
   the equations. directional, adjoint: null where it does not offer such derivatives. relative: step of central
   differences, of a value or else its nominal. Scales (n, 2): SI = factor value + offset. refs: of inputs, outputs,
   [x'; y] and [x; u], how many of each, which with arrays are fewer than the values. idle: inputs where none are given.
   seen: inputs, as the FMU has them, and event indicators where x' was asked for last. work: zeros, as many as
   compiled.py says. */
typedef struct {
    int64_t version, n_x, n_u, n_y, n_z, n_p, timed, guarded, n_pairs;
    int64_t counts[4];
    void *set_time, *set_x, *get_xdot, *get_z, *set_real, *get_real, *directional, *adjoint;
    const uint32_t *refs[4];
    const double *u_scales, *y_scales, *nominals, *idle;
    double relative;
    int64_t n_ready;
    const rs_ready *ready;
    const rs_pair *pairs;
    double *seen, *work;
} rs_fmu;

/* Some rows of [x'; y]; groups: whether t, x, u, p are arguments; wanted: whether weighted sums of derivatives by them are
   results. slow: gets self, arguments and results. */
typedef struct rs_function {
    rs_fmu *fmu;
    int64_t n_rows;
    const int64_t *rows;
    int64_t groups[4], wanted[4];
    void (*slow)(void *, const double *, double *);
} rs_function;

typedef int (*time_)(void *, double);
typedef int (*set_)(void *, const double *, size_t);
typedef int (*get_)(void *, double *, size_t);
typedef int (*real2)(void *, const uint32_t *, size_t, double *);
typedef int (*real3)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*along2)(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, double *);
typedef int (*along3)(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, size_t, double *,
                      size_t); /* the adjoint ones, too */

static int access_real(const rs_fmu *f, void *function, void *instance, int which, double *values, int64_t n) {
    const uint32_t *refs = f->refs[which];
    size_t count = (size_t)f->counts[which];
    return f->version == 2 ? ((real2)function)(instance, refs, count, values)
                           : ((real3)function)(instance, refs, count, values, (size_t)n);
}

/* Set a point; return the worst status. */
static int set_point(const rs_fmu *f, const rs_instance *i, double t, const double *x, const double *u) {
    double *raw = f->work;
    int worst = ((time_)f->set_time)(i->instance, t), status;
    if (f->n_x && (status = ((set_)f->set_x)(i->instance, x, (size_t)f->n_x)) > worst) worst = status;
    if (f->n_u) {
        for (int64_t k = 0; k < f->n_u; k++) raw[k] = (u[k] - f->u_scales[2 * k + 1]) / f->u_scales[2 * k];
        if ((status = access_real(f, f->set_real, i->instance, 0, raw, f->n_u)) > worst) worst = status;
    }
    return worst;
}

/* Whether all indicators are on the sides of the mode, or nobody asks for that. */
static int in_mode(const rs_fmu *f, const rs_instance *i) {
    const double *z = f->seen + f->n_u;
    for (int64_t k = 0; k < f->n_z && f->guarded; k++)
        if ((z[k] > 0.0) != (i->sides[k] > 0.0)) return 0;
    return 1;
}

/* Put [x'; y] at a point into out, as far as it is wanted; return whether all is well and the mode is the same. */
static int evaluated_here(const rs_fmu *f, const rs_instance *i, double t, const double *x, const double *u, int rates,
                          int outputs, double *out) {
    if (set_point(f, i, t, x, u) > 1) return 0;
    if (rates && f->n_x && ((get_)f->get_xdot)(i->instance, out, (size_t)f->n_x) > 1) return 0;
    if (rates && f->n_z && (((get_)f->get_z)(i->instance, f->seen + f->n_u, (size_t)f->n_z) > 1 || !in_mode(f, i)))
        return 0;
    if (rates && f->n_u) memcpy(f->seen, f->work, (size_t)f->n_u * sizeof(double));
    if (outputs && f->n_y) {
        double *y = out + f->n_x;
        if (access_real(f, f->get_real, i->instance, 1, y, f->n_y) > 1) return 0;
        for (int64_t k = 0; k < f->n_y; k++) y[k] = f->y_scales[2 * k] * y[k] + f->y_scales[2 * k + 1];
    }
    return 1;
}

/* Take the rows out of [x'; y]; return whether they are numbers. */
static int taken(const rs_function *self, const double *from, double *to) {
    int sound = 1;
    for (int64_t k = 0; k < self->n_rows; k++) {
        to[k] = from[self->rows[k]];
        sound = sound && isfinite(to[k]);
    }
    return sound;
}

static void wanted(const rs_function *self, int *rates, int *outputs) {
    *rates = *outputs = 0;
    for (int64_t k = 0; k < self->n_rows; k++) {
        *rates = *rates || self->rows[k] < self->fmu->n_x;
        *outputs = *outputs || self->rows[k] >= self->fmu->n_x;
    }
}

/* The parts of arguments, t, x, u, p; those that are none point to zeros, u to idle ones. */
static const double *parts(const rs_function *self, const double *a, const double **part, const double *zeros,
                           const double *idle) {
    const rs_fmu *f = self->fmu;
    const int64_t sizes[4] = {1, f->n_x, f->n_u, f->n_p};
    for (int g = 0; g < 4; g++) {
        part[g] = self->groups[g] ? a : g == 2 ? idle : zeros;
        if (self->groups[g]) a += sizes[g];
    }
    return a;
}

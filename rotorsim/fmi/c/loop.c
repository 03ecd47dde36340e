/* The loop of an explicit co-simulation with a fixed communication step, over members in this process: FMUs for
   Co-Simulation (FMI 2.0, 3.0) and compiled parts of a diagram. See loop.py, which fills the structures. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <math.h>

#if defined _WIN32
#define RS_EXPORT __declspec(dllexport)
#else
#define RS_EXPORT __attribute__((visibility("default")))
#endif

typedef struct { void *function; const uint32_t *references; size_t n_references; void *values; size_t n; } rs_call;

/* kind: 0 a compiled part, 2 and 3 an FMU of that version. A part: m its memory, p its parameters, step its own. */
typedef struct {
    int64_t kind, n_set, n_get, unbound;
    void *instance, *do_step;
    const rs_call *set, *get;
    void *run, *record;
    const double *p;
    double *m, *x, *z, *y, *row;
    double step, last;
    int64_t warned;
} rs_member;

typedef int (*access2)(void *, const uint32_t *, size_t, void *);
typedef int (*access3)(void *, const uint32_t *, size_t, void *, size_t);
typedef int (*step2)(void *, double, double, int);
typedef int (*step3)(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int64_t (*run_part)(const double *, double *, int64_t, int64_t, double, double, int64_t, double *);
typedef void (*record_part)(double, const double *, const double *, const double *, double *, double *);

enum { SET = 1, STEP, GET, EARLY, ENDED };

static int access(rs_member *a, const rs_call *calls, int64_t n) {
    for (int64_t k = 0; k < n; k++) {
        const rs_call *c = calls + k;
        int status = a->kind == 2 ? ((access2)c->function)(a->instance, c->references, c->n_references, c->values)
                                  : ((access3)c->function)(a->instance, c->references, c->n_references, c->values, c->n);
        if (status > 1) return status;
        a->warned += status;
    }
    return 0;
}

/* Set the inputs, step from t to t + h (h = 0: no step), get the outputs; return 0, or what failed + 16 status. */
static int advance(rs_member *a, double t, double h) {
    int status;
    if (a->kind == 0) {
        if (h > 0.0) {
            int64_t count = (int64_t)ceil(h / a->step - 1e-9);
            if (count < 1) count = 1;
            double width = h / (double)count;
            for (int64_t k = 0; k < count; k++)
                ((run_part)a->run)(a->p, a->m, 0, 1, t + (double)k * width, width, 1, a->row);
        }
        ((record_part)a->record)(t + h, a->x, a->z, a->p, a->m, a->y);
        return 0;
    }
    if ((status = access(a, a->set, a->n_set))) return SET + 16 * status;
    if (h > 0.0) {
        if (a->kind == 2) {
            if ((status = ((step2)a->do_step)(a->instance, t, h, (int)a->unbound)) > 1) return STEP + 16 * status;
            a->warned += status;
        } else {
            bool event = false, ended = false, early = false;
            status = ((step3)a->do_step)(a->instance, t, h, a->unbound, &event, &ended, &early, &a->last);
            if (status > 1) return STEP + 16 * status;
            a->warned += status;
            if (early && fabs(a->last - t - h) > 1e-9 * h) return EARLY;
            if (ended) return ENDED;
        }
    }
    if ((status = access(a, a->get, a->n_get))) return GET + 16 * status;
    return 0;
}

/* u = u0 + L y for the inputs first..last-1; L by rows: start, column, gain. Return whether any of them changed. */
static bool connect(int64_t first, int64_t last, const int64_t *start, const int64_t *column, const double *gain,
                    const double *u0, double **u, double **y) {
    bool changed = false;
    for (int64_t i = first; i < last; i++) {
        double sum = u0[i];
        for (int64_t j = start[i]; j < start[i + 1]; j++) sum += gain[j] * *y[column[j]];
        changed = changed || *u[i] != sum;
        *u[i] = sum;
    }
    return changed;
}

/* Take the steps n0..n1-1 of length h from t0 on. order: of the members; sequential: those that come later see the new
   outputs of the earlier (Gauss-Seidel), else all see the old (Jacobi). sweeps: how often, at most, inputs and outputs
   are made to agree after a step. rows: y after each step that `every` divides.
   Returns the number of steps done; failed: {member, what}, what = 0 if none. */
RS_EXPORT int64_t rs_cosimulate(rs_member *members, int64_t count, const int64_t *order, int64_t sequential,
                                const int64_t *first, const int64_t *start, const int64_t *column, const double *gain,
                                const double *u0, double **u, int64_t n_y, double **y, double t0, double h, int64_t n0,
                                int64_t n1, int64_t every, int64_t sweeps, double *rows, int64_t *failed) {
    failed[0] = failed[1] = 0;
    for (int64_t n = n0; n < n1; n++) {
        double t = t0 + (double)n * h, width = t0 + (double)(n + 1) * h - t;
        if (!sequential) connect(0, first[count], start, column, gain, u0, u, y);
        for (int64_t k = 0; k < count; k++) {
            int64_t member = order[k];
            if (sequential) connect(first[member], first[member + 1], start, column, gain, u0, u, y);
            int what = advance(members + member, t, width);
            if (what) {
                failed[0] = member;
                failed[1] = what;
                return n - n0;
            }
        }
        for (int64_t s = 0; s < sweeps && connect(0, first[count], start, column, gain, u0, u, y); s++)
            for (int64_t k = 0; k < count; k++) {
                int what = advance(members + k, t + width, 0.0);
                if (what) {
                    failed[0] = k;
                    failed[1] = what;
                    return n - n0;
                }
            }
        if ((n + 1) % every == 0) {
            bool finite = true;
            for (int64_t j = 0; j < n_y; j++) {
                *rows++ = *y[j];
                finite = finite && isfinite(*y[j]);
            }
            if (!finite) return n + 1 - n0;
        }
    }
    return n1 - n0;
}

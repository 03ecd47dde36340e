/* The loop of an explicit co-simulation with a fixed communication step, over compiled parts of a diagram and FMUs for
   Co-Simulation (FMI 2.0, 3.0), in this process or in their own. See loop.py, which fills the structures, and steps.py,
   which defines RS_...: places in the block that is shared with a process (block.py), kinds, states, what is returned. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <math.h>

#if defined _WIN32
#define RS_EXPORT __declspec(dllexport)
#else
#include <sched.h>
#include <unistd.h>
#define RS_EXPORT __attribute__((visibility("default")))
#endif

/* number: of the function, as it is told to whoever finds the process dead (calls.py). */
typedef struct {
    int64_t number;
    void *function;
    const uint32_t *references;
    size_t n_references;
    void *values;
    size_t n;
} rs_call;

/* kind: RS_PART, RS_PROCESS (an FMU in its own), else 2 and 3, an FMU of that version. A part: m its memory, p its
   parameters, step its own. An FMU: head of its block. Between processes: count of the last request, looks at the other
   side before waiting otherwise, bell: the descriptor that wakes it. state: in this pass. */
typedef struct {
    int64_t kind, state, n_set, n_get, unbound;
    void *instance, *do_step;
    const rs_call *set, *get;
    void *run, *record;
    const double *p;
    double *m, *x, *z, *y, *row;
    double step;
    int64_t *head, count, looks, bell;
} rs_member;

/* Where a loop is that was left to wait for a process: in the step itself or a sweep after it; begun: inputs are set. */
typedef struct { int64_t sweep, begun; } rs_place;

typedef int (*access2)(void *, const uint32_t *, size_t, void *);
typedef int (*access3)(void *, const uint32_t *, size_t, void *, size_t);
typedef int (*step2)(void *, double, double, int);
typedef int (*step3)(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int64_t (*run_part)(const double *, double *, int64_t, int64_t, double, double, int64_t, double *);
typedef void (*record_part)(double, const double *, const double *, const double *, double *, double *);

static int64_t call_all(rs_member *a, const rs_call *calls, int64_t n) {
    for (int64_t k = 0; k < n; k++) {
        const rs_call *c = calls + k;
        a->head[RS_FUNCTION] = c->number;
        int status = a->kind == 2 ? ((access2)c->function)(a->instance, c->references, c->n_references, c->values)
                                  : ((access3)c->function)(a->instance, c->references, c->n_references, c->values, c->n);
        if (status & ~1) return status;
        a->head[RS_WARNED] += status;
    }
    return 0;
}

/* Set the inputs, step from t to t + h (h = 0: no step), get the outputs; return 0, or what failed + 16 status. */
static int64_t advance(rs_member *a, double t, double h) {
    int64_t status;
    if (a->kind == RS_PART) {
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
    if ((status = call_all(a, a->set, a->n_set))) return RS_SET + 16 * status;
    bool event = false, ended = false, early = false;
    if (h > 0.0) {
        double *last = (double *)a->head + RS_LAST;
        a->head[RS_FUNCTION] = RS_DO_STEP;
        status = a->kind == 2 ? ((step2)a->do_step)(a->instance, t, h, (int)a->unbound)
                              : ((step3)a->do_step)(a->instance, t, h, a->unbound, &event, &ended, &early, last);
        if (status & ~1) return RS_STEP + 16 * status;
        a->head[RS_WARNED] += status;
        if (early && fabs(*last - t - h) > 1e-9 * h) return RS_EARLY;
        a->head[RS_SAID] = ended ? RS_TERMINATE : 0;
    }
    if ((status = call_all(a, a->get, a->n_get))) return RS_GET + 16 * status;
    a->head[RS_FUNCTION] = 0;
    return ended ? RS_ENDED : 0;
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

/* Ask a process for what `advance` does. */
static void ask(rs_member *a, double t, double h) {
#if !defined _WIN32
    double *numbers = (double *)a->head;
    a->head[RS_OP] = RS_OP_U | RS_OP_Y;
    if (h > 0.0) {
        numbers[RS_T] = t;
        numbers[RS_H] = h;
        a->head[RS_OP] |= RS_OP_STEP;
    }
    __atomic_store_n(a->head + RS_REQUEST, ++a->count, __ATOMIC_SEQ_CST);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    if (__atomic_load_n(a->head + RS_FMU_SLEEPS, __ATOMIC_SEQ_CST) && write((int)a->bell, "\0\0\0", 4) != 4)
        a->looks = 0; /* it is gone, as whoever waits will find */
#endif
}

/* In the process of an FMU: do what is asked while it is what `ask` asks. Return 0 where nothing came in so many looks or
   something else is asked, or what failed; a->count: the last request that was taken up. */
RS_EXPORT int64_t rs_serve(rs_member *a) {
#if !defined _WIN32
    double *numbers = (double *)a->head;
    for (;;) {
        int64_t k = 0, request, op;
        while ((request = __atomic_load_n(a->head + RS_REQUEST, __ATOMIC_ACQUIRE)) == a->count) {
            if (k++ >= a->looks) return 0;
            sched_yield();
        }
        op = a->head[RS_OP];
        if ((op | RS_OP_STEP) != (RS_OP_U | RS_OP_STEP | RS_OP_Y)) return 0;
        if (op & RS_OP_STEP && !(numbers[RS_H] > 0.0)) return 0;
        a->count = request;
        int64_t what = advance(a, numbers[RS_T], op & RS_OP_STEP ? numbers[RS_H] : 0.0);
        if (what && what != RS_ENDED) return what;
        __atomic_store_n(a->head + RS_REPLY, request, __ATOMIC_SEQ_CST);
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
        if (__atomic_load_n(a->head + RS_USER_SLEEPS, __ATOMIC_SEQ_CST) && write((int)a->bell, "\0\0\0", 4) != 4)
            return 0; /* the pipe is closed, as whoever waits at it will find */
    }
#endif
    return 0;
}

/* Look for the reply of a process that was asked; return 0, or RS_LATE where it has to be waited for or says more. */
static int64_t look(rs_member *a) {
    if (a->state == RS_DONE) return 0;
#if !defined _WIN32
    for (int64_t k = 0; k < a->looks; k++) {
        if (__atomic_load_n(a->head + RS_REPLY, __ATOMIC_ACQUIRE) == a->count) {
            if (a->head[RS_STATUS] || a->head[RS_SAID]) return RS_LATE;
            a->state = RS_DONE;
            return 0;
        }
        sched_yield(); /* see channel.py */
    }
#endif
    return RS_LATE;
}

/* Take the steps n0..n1-1 of length h from t0 on, to end at most. order: of the members; sequential: those that come
   later see the new outputs of the earlier (Gauss-Seidel), else all see the old (Jacobi), and processes work at the
   same time. sweeps: how often, at most, inputs and outputs are made to agree after a step. rows: y after each step that `every` divides.
   Returns the number of steps done; failed: {member, what}, what = 0 if none. After RS_LATE, once it is RS_DONE, the
   loop goes on with n0 where it was, at the same place. */
RS_EXPORT int64_t rs_cosimulate(rs_member *members, int64_t count, const int64_t *order, int64_t sequential,
                                const int64_t *first, const int64_t *start, const int64_t *column, const double *gain,
                                const double *u0, double **u, int64_t n_y, double **y, double t0, double h, double end,
                                int64_t n0, int64_t n1, int64_t every, int64_t sweeps, double *rows, int64_t *failed,
                                rs_place *place) {
    int64_t what;
    failed[0] = failed[1] = 0;
    for (int64_t n = n0; n < n1; n++) {
        double t = t0 + (double)n * h, width = fmin(t0 + (double)(n + 1) * h, end) - t;
        for (; place->sweep <= sweeps; place->sweep++) {
            bool again = place->sweep > 0, one_by_one = sequential && !again;
            if (!place->begun) {
                if (!one_by_one && !connect(0, first[count], start, column, gain, u0, u, y) && again) break;
                for (int64_t k = 0; k < count; k++) members[k].state = RS_TODO;
                place->begun = 1;
            }
            for (int64_t k = 0; k < count; k++) {
                rs_member *a = members + order[k];
                failed[0] = order[k];
                if (a->state == RS_TODO) {
                    if (one_by_one) connect(first[order[k]], first[order[k] + 1], start, column, gain, u0, u, y);
                    if (a->kind == RS_PROCESS) ask(a, t, again ? 0.0 : width);
                    else if ((failed[1] = advance(a, again ? t + width : t, again ? 0.0 : width))) return n - n0;
                    a->state = a->kind == RS_PROCESS ? RS_ASKED : RS_DONE;
                }
                if (one_by_one && (failed[1] = look(a))) return n - n0;
            }
            for (int64_t k = 0; k < count; k++)
                if ((what = look(members + k))) {
                    failed[0] = k;
                    failed[1] = what;
                    return n - n0;
                }
            place->begun = 0;
        }
        place->sweep = 0;
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

/* The equations of an FMU for Model Exchange, in this process or in its own, as functions that compiled code calls: its
   last instances are asked at once, and whoever made these structures (compiled.py) for all that is unusual: other
   parameters, events, failures. A function says so by leaving to `slow`, which answers in its place. Places in the block
   that is shared with a process, and bits of what is asked, are defined by steps.py. */
#if defined _WIN32
#define RS_EXPORT __declspec(dllexport)
#else
#include <sched.h>
#include <unistd.h>
#define RS_EXPORT __attribute__((visibility("default")))
#endif

#define RS_VANISHED 1e-250 /* as in equations.py */

/* What is known of a process of its own: head of the block, count of the last request, looks at the other side before
   waiting otherwise, bell: the descriptor that wakes it; where vectors lie in the block; picked: where each output does
   among all. */
struct rs_remote {
    int64_t *head, count, looks, bell, u, y, x, xdot, z;
    const int64_t *picked;
};

#if !defined _WIN32
/* Whether a process has answered what it was asked last. */
static int idle(const rs_remote *r) {
    return __atomic_load_n(r->head + RS_REPLY, __ATOMIC_ACQUIRE) == r->count && !r->head[RS_STATUS];
}

/* Ask a process for what these bits say; return whether it has answered. */
static int answered(rs_remote *r, int64_t op) {
    r->head[RS_OP] = op;
    __atomic_store_n(r->head + RS_REQUEST, ++r->count, __ATOMIC_SEQ_CST);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    if (__atomic_load_n(r->head + RS_FMU_SLEEPS, __ATOMIC_SEQ_CST) && write((int)r->bell, "\0\0\0", 4) != 4) return 0;
    for (int64_t k = 0; __atomic_load_n(r->head + RS_REPLY, __ATOMIC_ACQUIRE) != r->count;) {
        if (k++ >= r->looks) return 0;
        sched_yield(); /* see channel.py */
    }
    return !r->head[RS_STATUS];
}
#endif

/* What `evaluated` does, by a process of its own. A request without an answer is left to who asks next. */
static int asked(const rs_fmu *f, const rs_instance *i, double t, const double *x, const double *u, int rates,
                 int outputs, double *out) {
#if !defined _WIN32
    rs_remote *r = i->remote;
    double *numbers = (double *)r->head;
    if (!idle(r)) return 0;
    numbers[RS_T] = t;
    memcpy(numbers + r->x, x, (size_t)f->n_x * sizeof *x);
    for (int64_t k = 0; k < f->n_u; k++) numbers[r->u + k] = (u[k] - f->u_scales[2 * k + 1]) / f->u_scales[2 * k];
    if (!answered(r, RS_OP_TIME | (f->n_x ? RS_OP_X : 0) | (f->n_u ? RS_OP_U : 0) | (rates && f->n_x ? RS_OP_XDOT : 0) |
                         (rates && f->n_z ? RS_OP_Z : 0) | (outputs && f->n_y ? RS_OP_Y : 0)))
        return 0;
    if (rates) {
        memcpy(out, numbers + r->xdot, (size_t)f->n_x * sizeof *out);
        memcpy(f->seen, numbers + r->u, (size_t)f->n_u * sizeof *out);
        memcpy(f->seen + f->n_u, numbers + r->z, (size_t)f->n_z * sizeof *out);
        if (!in_mode(f, i)) return 0;
    }
    for (int64_t k = 0; k < f->n_y && outputs; k++)
        out[f->n_x + k] = f->y_scales[2 * k] * numbers[r->y + r->picked[k]] + f->y_scales[2 * k + 1];
    return 1;
#else
    return 0;
#endif
}

/* Put [x'; y] at a point into out, as far as it is wanted; return whether all is well and no event is due. */
static int evaluated(const rs_fmu *f, const rs_instance *i, double t, const double *x, const double *u, int rates,
                     int outputs, double *out) {
    if (f->guarded && t >= i->due) return 0;
    return i->remote ? asked(f, i, t, x, u, rates, outputs, out)
                     : evaluated_here(f, i, t, x, u, rates, outputs, out);
}

/* The instance with parameters p, or null. */
static const rs_instance *ready(const rs_fmu *f, const double *p) {
    for (int64_t k = 0; k < f->n_ready; k++)
        if (f->ready[k].p && memcmp(p, f->ready[k].p, (size_t)f->n_p * sizeof *p) == 0) return &f->ready[k].of;
    return NULL;
}

/* An instance that is told of completed steps; unbound: no state before them will be set again. */
typedef struct {
    const rs_fmu *fmu;
    const double *p;
    void *function;
    int64_t unbound;
} rs_completed;

typedef int (*completed2)(void *, int, int *, int *);
typedef int (*completed3)(void *, _Bool, _Bool *, _Bool *);

/* Tell an instance that the step to the present point is completed. said: what it wants, or a status beyond a warning,
   negative: it is not to be told twice to find out why. */
static void complete(int64_t version, void *function, void *instance, int64_t unbound, int64_t *said) {
    int event2 = 0, end2 = 0, status;
    _Bool event3 = 0, end3 = 0;
    status = version == 2 ? ((completed2)function)(instance, (int)unbound, &event2, &end2)
                          : ((completed3)function)(instance, unbound != 0, &event3, &end3);
    *said = status & ~1 ? -(int64_t)(status > 1 && status < 6 ? status : 99) : (event2 || event3 ? RS_EVENT : 0) | (end2 || end3 ? RS_TERMINATE : 0);
}

/* Tell an instance of a completed step, once; return what it said, RS_UNTOLD where it is not there, RS_PENDING where its
   process has not answered yet. */
RS_EXPORT int64_t rs_fmu_completed(void *context) {
    const rs_completed *self = context;
    const rs_instance *i = ready(self->fmu, self->p);
    int64_t said;
    if (!i) return RS_UNTOLD;
#if !defined _WIN32
    if (i->remote) {
        if (!idle(i->remote)) return RS_UNTOLD;
        return answered(i->remote, RS_OP_COMPLETED) ? i->remote->head[RS_SAID] : RS_PENDING;
    }
#endif
    complete(self->fmu->version, self->function, i->instance, self->unbound, &said);
    return said;
}

static int any(const double *a, int64_t n) {
    for (int64_t k = 0; k < n; k++)
        if (a[k] != 0.0) return 1;
    return 0;
}

/* arguments -> rows of [x'; y] */
RS_EXPORT void rs_fmu_values(void *context, const double *arguments, double *results) {
    const rs_function *self = context;
    const rs_fmu *f = self->fmu;
    double *out = f->work + f->n_u, *zeros = out + 2 * (f->n_x + f->n_y) + f->n_x + f->n_u;
    const double *part[4];
    int rates, outputs;
    parts(self, arguments, part, zeros, f->idle);
    wanted(self, &rates, &outputs);
    const rs_instance *i = ready(f, part[3]);
    if (!i || !evaluated(f, i, *part[0], part[1], part[2], rates, outputs, out) ||
        !taken(self, out, results))
        self->slow(context, arguments, results);
}

/* Put the sums of derivatives of [x'; y], with these weights (scratch), by x and u into out (n_x + n_u), from an adjoint
   derivative at the point that is set; return whether all is well. */
static int against(const rs_fmu *f, const rs_instance *i, double *weights, double *out) {
    const int64_t n = f->n_x + f->n_y, m = f->n_x + f->n_u;
    for (int64_t k = 0; k < f->n_y; k++) weights[f->n_x + k] *= f->y_scales[2 * k];
    if (((along3)f->adjoint)(i->instance, f->refs[2], (size_t)f->counts[2], f->refs[3], (size_t)f->counts[3], weights,
                             (size_t)n, out, (size_t)m) > 1)
        return 0;
    for (int64_t k = 0; k < f->n_u; k++) out[f->n_x + k] /= f->u_scales[2 * k];
    return 1;
}

/* Put the derivatives of [x'; y] in a direction of x and u into out, from directional derivatives, else from adjoint ones
   row by row, else by a central difference over a step that is small beside every entry that moves; return whether all
   is well. direction: n_x + n_u. */
static int along_states(const rs_fmu *f, const double *const *part, double *direction, int rates, int outputs,
                        double *out) {
    const int64_t n = f->n_x + f->n_y, m = f->n_x + f->n_u;
    double room = INFINITY, *other = out + n, *moved = other + n;
    const rs_instance *i = ready(f, part[3]);
    if (!i || (f->guarded && *part[0] >= i->due)) return 0;
    if (f->directional && !i->remote) {
        if (set_point(f, i, *part[0], part[1], part[2]) > 1) return 0;
        for (int64_t k = 0; k < f->n_u; k++) direction[f->n_x + k] /= f->u_scales[2 * k];
        const size_t c2 = (size_t)f->counts[2], c3 = (size_t)f->counts[3];
        int status = f->version == 2
                         ? ((along2)f->directional)(i->instance, f->refs[2], c2, f->refs[3], c3, direction, out)
                         : ((along3)f->directional)(i->instance, f->refs[2], c2, f->refs[3], c3, direction,
                                                    (size_t)m, out, (size_t)n);
        for (int64_t k = 0; k < f->n_y; k++) out[f->n_x + k] *= f->y_scales[2 * k];
        return status <= 1;
    }
    if (f->adjoint && !i->remote) {
        if (set_point(f, i, *part[0], part[1], part[2]) > 1) return 0;
        for (int64_t k = 0; k < n; k++) {
            for (int64_t j = 0; j < n; j++) other[j] = j == k;
            if (!against(f, i, other, moved)) return 0;
            out[k] = 0.0;
            for (int64_t j = 0; j < m; j++) out[k] += moved[j] * direction[j];
        }
        return 1;
    }
    for (int64_t k = 0; k < m; k++) {
        const double value = k < f->n_x ? part[1][k] : part[2][k - f->n_x];
        const double size = fabs(value) > RS_VANISHED ? fabs(value) : k < f->n_x ? f->nominals[k] : 1.0;
        if (direction[k] != 0.0 && size / fabs(direction[k]) < room) room = size / fabs(direction[k]);
    }
    const double step = f->relative * room;
    for (int side = 0; side < 2; side++) {
        for (int64_t k = 0; k < m; k++) {
            const double value = k < f->n_x ? part[1][k] : part[2][k - f->n_x];
            moved[k] = value + (side ? -step : step) * direction[k];
        }
        if (!evaluated(f, i, *part[0], moved, moved + f->n_x, rates, outputs, side ? other : out)) return 0;
    }
    for (int64_t k = 0; k < n; k++) out[k] = (out[k] - other[k]) / (2.0 * step);
    return 1;
}

/* The same in a direction of p whose instances are known. */
static int along_parameters(const rs_fmu *f, const double *const *part, const double *seed, int rates, int outputs,
                            double *out) {
    const int64_t n = f->n_x + f->n_y;
    const size_t size = (size_t)f->n_p * sizeof(double);
    double *other = out + n;
    for (int64_t k = 0; k < f->n_pairs; k++) {
        const rs_pair *pair = f->pairs + k;
        if (pair->step == 0.0 || memcmp(pair->p, part[3], size) || memcmp(pair->seed, seed, size)) continue;
        if (!evaluated(f, &pair->high, *part[0], part[1], part[2], rates, outputs, out) ||
            !evaluated(f, &pair->low, *part[0], part[1], part[2], rates, outputs, other))
            return 0;
        for (int64_t j = 0; j < n; j++) out[j] = (out[j] - other[j]) / (2.0 * pair->step);
        return 1;
    }
    return 0;
}

/* The same by the time. */
static int along_time(const rs_fmu *f, const double *const *part, int rates, int outputs, double *out) {
    const double t = *part[0], step = f->relative * (t != 0.0 ? fabs(t) : 1.0);
    double *other = out + f->n_x + f->n_y;
    const rs_instance *i = ready(f, part[3]);
    if (!i || !evaluated(f, i, t + step, part[1], part[2], rates, outputs, out) ||
        !evaluated(f, i, t - step, part[1], part[2], rates, outputs, other))
        return 0;
    for (int64_t j = 0; j < f->n_x + f->n_y; j++) out[j] = (out[j] - other[j]) / (2.0 * step);
    return 1;
}

/* arguments, results at them, directions -> derivatives of rows of [x'; y] in a direction */
RS_EXPORT void rs_fmu_forward(void *context, const double *arguments, double *results) {
    const rs_function *self = context;
    const rs_fmu *f = self->fmu;
    const int64_t n = f->n_x + f->n_y, m = f->n_x + f->n_u;
    double *out = f->work + f->n_u, *zeros = out + 2 * n + m, *direction = zeros + f->n_p + m + 1;
    const double *part[4], *seed[4];
    const double *rest = parts(self, arguments, part, zeros, f->idle);
    int rates, outputs;
    parts(self, rest + self->n_rows, seed, zeros, zeros);
    wanted(self, &rates, &outputs);
    const int in_t = f->timed && seed[0][0] != 0.0, in_p = any(seed[3], f->n_p);
    const int in_xu = any(seed[1], f->n_x) || any(seed[2], f->n_u);
    if (!in_t && !in_p && !in_xu) {
        for (int64_t k = 0; k < self->n_rows; k++) results[k] = 0.0;
        return;
    }
    for (int64_t k = 0; k < m; k++) direction[k] = k < f->n_x ? seed[1][k] : seed[2][k - f->n_x];
    if (in_t || (in_p && in_xu) ||
        !(in_p ? along_parameters(f, part, seed[3], rates, outputs, out)
               : along_states(f, part, direction, rates, outputs, out)) ||
        !taken(self, out, results))
        self->slow(context, arguments, results);
}

/* arguments, results at them, weights of rows of [x'; y] -> the weighted sums of their derivatives by arguments */
RS_EXPORT void rs_fmu_reverse(void *context, const double *arguments, double *results) {
    const rs_function *self = context;
    const rs_fmu *f = self->fmu;
    const int64_t n = f->n_x + f->n_y, m = f->n_x + f->n_u, sizes[4] = {1, f->n_x, f->n_u, f->n_p};
    double *out = f->work + f->n_u, *zeros = out + 2 * n + m, *direction = zeros + f->n_p + m + 1;
    double *rows = direction + m, *seed = rows + n, *gradient = seed + f->n_p, *to = results;
    const double *part[4];
    const double *weights = parts(self, arguments, part, zeros, f->idle) + self->n_rows;
    int rates, outputs, sound = 1;
    wanted(self, &rates, &outputs);
    const rs_instance *i = ready(f, part[3]);
    const int in_xu = (self->groups[1] && self->wanted[1]) || (self->groups[2] && self->wanted[2]);
    const int at_once = in_xu && f->adjoint && i && !i->remote; /* all of them by one call */
    if (at_once) {
        for (int64_t k = 0; k < n; k++) rows[k] = 0.0;
        for (int64_t k = 0; k < self->n_rows; k++) rows[self->rows[k]] += weights[k];
        sound = !(f->guarded && *part[0] >= i->due) && set_point(f, i, *part[0], part[1], part[2]) <= 1 &&
                against(f, i, rows, gradient);
        for (int64_t k = 0; k < m && sound; k++) sound = isfinite(gradient[k]);
    }
    for (int g = 0; g < 4 && sound; g++)
        for (int64_t c = 0; self->groups[g] && self->wanted[g] && c < sizes[g] && sound; c++) {
            double sum = 0.0;
            if (at_once && (g == 1 || g == 2)) {
                sum = gradient[c + (g == 2 ? f->n_x : 0)];
            } else if (g || f->timed) {
                for (int64_t k = 0; k < m; k++) direction[k] = (g == 1 || g == 2) && k == c + (g == 2 ? f->n_x : 0) ? 1.0 : 0.0;
                for (int64_t k = 0; k < f->n_p; k++) seed[k] = g == 3 && k == c ? 1.0 : 0.0;
                sound = (g == 0   ? along_time(f, part, rates, outputs, out)
                         : g == 3 ? along_parameters(f, part, seed, rates, outputs, out)
                                  : along_states(f, part, direction, rates, outputs, out)) &&
                        taken(self, out, rows);
                for (int64_t k = 0; k < self->n_rows && sound; k++) sum += weights[k] * rows[k];
            }
            *to++ = sum;
        }
    if (!sound) self->slow(context, arguments, results);
}

/* A call in the process of an FMU: op: the bit that asks for it; number: of the function, as it is told to whoever finds
   the process dead; references: null for a vector of states, their rates or event indicators, and for the time. */
typedef struct {
    int64_t op, number;
    void *function;
    const uint32_t *references;
    size_t n_references;
    void *values;
    size_t n;
} rs_asked;

typedef struct {
    int64_t version, n_calls, unbound;
    void *instance;
    const rs_asked *calls;
    int64_t *head, count, looks, bell;
} rs_server;

/* In the process of an FMU: do what `asked` asks, until nothing came in so many looks, something else is asked, or a call
   fails, which is done once more by those who can say why. count: the last request that was taken up. */
RS_EXPORT int64_t rs_serve_equations(rs_server *s) {
#if !defined _WIN32
    int64_t all = RS_OP_TIME | RS_OP_X | RS_OP_U | RS_OP_XDOT | RS_OP_Y | RS_OP_Z;
    for (int64_t k = 0; k < s->n_calls; k++) all |= s->calls[k].op;
    double *numbers = (double *)s->head;
    for (;;) {
        int64_t k = 0, request;
        while ((request = __atomic_load_n(s->head + RS_REQUEST, __ATOMIC_ACQUIRE)) == s->count) {
            if (k++ >= s->looks) return 0;
            sched_yield();
        }
        const int64_t op = s->head[RS_OP];
        if (op <= 0 || op & ~all) return 0;
        for (k = 0; k < s->n_calls; k++) {
            const rs_asked *c = s->calls + k;
            if (!(op & c->op)) continue;
            s->head[RS_FUNCTION] = c->number;
            if (c->op == RS_OP_COMPLETED) {
                complete(s->version, c->function, s->instance, s->unbound, s->head + RS_SAID);
                continue;
            }
            int status = c->op == RS_OP_TIME ? ((time_)c->function)(s->instance, numbers[RS_T])
                         : !c->references    ? ((get_)c->function)(s->instance, c->values, c->n)
                         : s->version == 2   ? ((real2)c->function)(s->instance, c->references, c->n_references, c->values)
                                             : ((real3)c->function)(s->instance, c->references, c->n_references,
                                                                    c->values, c->n);
            if (status & ~1) return 0;
            s->head[RS_WARNED] += status;
        }
        s->head[RS_FUNCTION] = 0;
        s->count = request;
        __atomic_store_n(s->head + RS_REPLY, request, __ATOMIC_SEQ_CST);
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
        if (__atomic_load_n(s->head + RS_USER_SLEEPS, __ATOMIC_SEQ_CST) && write((int)s->bell, "\0\0\0", 4) != 4)
            return 0; /* the pipe is closed, as whoever waits at it will find */
    }
#endif
    return 0;
}

/* Small systems with events, one of which the parameter `model` chooses; see ../events.py.
   x, v: states. on, count, next: discrete. when: time of the last event that changed something. */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BALL, RELAY, CLOCK, CHATTER, SIGNAL, LATE, STAGES, TWO };

typedef struct {
    double t, x, v, u, level, when, next, gravity, restitution, low, high, time_constant, tick, stop_at, before;
    int model, on, count, phase, begun, failed;
} System;

static void begin(System *s) {
    memset(s, 0, sizeof *s);
    s->x = 1.0, s->gravity = 9.81, s->restitution = 0.8, s->low = 0.5, s->high = 1.5, s->time_constant = 1.0;
    s->tick = 0.25, s->next = INFINITY, s->stop_at = 1e9, s->on = 1;
}

static void slope(const System *s, double *dx, double *dv) {
    *dx = *dv = 0.0;
    switch (s->model) {
        case BALL: *dx = s->v, *dv = -s->gravity; break;
        case RELAY: *dx = ((s->on ? 2.0 : 0.0) - s->x) / s->time_constant; break;
        case CLOCK: case STAGES: *dx = s->count; break;
        case CHATTER: *dx = s->on ? -1.0 : 1.0; break;
        case SIGNAL: *dx = (s->on ? 1.0 : 0.0) + s->level; break;
        case LATE: *dx = 1.0; break;
        case TWO: *dx = s->v, *dv = -s->x; break;
    }
}

static double indicator(const System *s) {
    switch (s->model) {
        case BALL: return s->x;
        case RELAY: return s->on ? s->high - s->x : s->x - s->low;
        case CHATTER: return s->x;
        case SIGNAL: return s->u - s->high;
        case TWO: return s->x - s->low;
    }
    return 1.0;
}

/* At a completed step: whether x has passed a height since the last one; who is told twice finds nothing. */
static int passed(System *s) {
    const int event = s->model == LATE && s->before < s->high && s->x >= s->high;
    s->before = s->x;
    return event;
}

/* One iteration of an event; return whether another is needed. */
static int update(System *s) {
    const int first = !s->begun;
    s->begun = 1;
    switch (s->model) {
        case BALL: /* not moved off the ground: its indicator is zero, or a rounding below */
            if (s->x <= 0.0 && s->v < 0.0) s->x = 0.0, s->v = -s->restitution * s->v, s->count++, s->when = s->t;
            break;
        case RELAY:
            if (s->on ? s->x >= s->high : s->x <= s->low) s->on = !s->on, s->count++, s->when = s->t;
            break;
        case CLOCK:
            if (first) s->next = s->tick;
            else if (s->t >= s->next) s->count++, s->when = s->t, s->next = (s->count + 1) * s->tick;
            break;
        case STAGES: /* one time event, three iterations */
            if (first) s->next = s->tick;
            else if (s->phase || s->t >= s->next) {
                s->next = INFINITY, s->count++, s->when = s->t, s->phase = (s->phase + 1) % 3;
                return s->phase;
            }
            break;
        case CHATTER: s->on = s->x > 0.0, s->count += !first; break;
        case SIGNAL:
            if (s->on != (s->u > s->high)) s->on = !s->on, s->count++, s->when = s->t;
            break;
        case LATE:
            if (s->x >= s->high) s->x -= s->high, s->count++, s->when = s->t;
            break;
        case TWO: s->count += !first, s->when = s->t; break;
    }
    return 0;
}

static double *number(System *s, unsigned r) {
    double *places[] = {0, &s->x, &s->v, 0, 0, &s->u, &s->level, 0, &s->when, &s->gravity, &s->restitution, &s->low,
                        &s->high, &s->time_constant, &s->tick, &s->stop_at, &s->x, &s->v}; /* 16, 17: start */
    return r < sizeof places / sizeof *places ? places[r] : 0;
}

static int get(System *s, const unsigned *r, size_t n, double *value) {
    double d[2];
    slope(s, d, d + 1);
    for (size_t k = 0; k < n; k++) {
        double *at = number(s, r[k]);
        if (r[k] == 0) value[k] = s->t;
        else if (r[k] == 3 || r[k] == 4) value[k] = d[r[k] - 3];
        else if (r[k] == 7) value[k] = s->count;
        else if (r[k] == 30) value[k] = indicator(s);
        else if (at) value[k] = *at;
        else return 3;
    }
    return 0;
}

static int set(System *s, const unsigned *r, size_t n, const double *value) {
    for (size_t k = 0; k < n; k++) {
        double *at = number(s, r[k]);
        if (!at) return 3;
        *at = value[k];
    }
    return 0;
}

/* A spring, a mass and a damper in each of N directions, with a wall and a clock: what the FMUs for tests do.
   x' = v, v' = u - stiffness x - damping v, y = x + gain u, per direction; x > wall: v := -v; count: ticks of `tick`.
   fault: what goes wrong in a step (or an evaluation) that begins at fault_time or later, with a stiffness of fault_above
   or more. */
#include <math.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { OK, SEGV, HANG, FAIL, NOT_A_NUMBER, DISCARD, HUNGRY, LEAVE, ABORT, PRINT, FATAL, BAD_FREE, TERMINATE, CHILD,
       BELOW, FLOOD, LEAVE_WELL, BAD_RESET, NO_RESET };

typedef struct {
    double t, x[N], v[N], u[N], stiffness, damping, gain, wall, tick, fault_time, fault_above, next;
    int fault, count, enabled, initialised, flooded, resets;
    char label[64];
    void *logger, *environment;
    const char *name;
} Plant;

static void begin(Plant *p) {
    memset(p->x, 0, sizeof p->x);
    memset(p->v, 0, sizeof p->v);
    memset(p->u, 0, sizeof p->u);
    p->x[0] = 1.0;
    p->stiffness = 100.0, p->damping = 0.5, p->gain = 0.0, p->wall = 1e9, p->tick = 0.0, p->fault_time = 0.0, p->fault_above = 0.0;
    p->t = 0.0, p->next = INFINITY, p->fault = OK, p->count = 0, p->enabled = 1, p->initialised = 0;
    strcpy(p->label, "none");
}

static void slope(const Plant *p, const double *x, const double *v, double *dx, double *dv) {
    const double stiffness = p->fault == BAD_RESET && p->resets ? 1.1 * p->stiffness : p->stiffness;
    for (int k = 0; k < N; k++) {
        dx[k] = v[k];
        dv[k] = (p->enabled ? p->u[k] : 0.0) - stiffness * x[k] - p->damping * v[k];
    }
}

/* One step of RK4. */
static void advance(Plant *p, double h) {
    double a[4][N], b[4][N], x[N], v[N];
    const double at[4] = {0.0, 0.5, 0.5, 1.0};
    for (int s = 0; s < 4; s++) {
        for (int k = 0; k < N; k++) {
            x[k] = p->x[k] + (s ? h * at[s] * a[s - 1][k] : 0.0);
            v[k] = p->v[k] + (s ? h * at[s] * b[s - 1][k] : 0.0);
        }
        slope(p, x, v, a[s], b[s]);
    }
    for (int k = 0; k < N; k++) {
        p->x[k] += h / 6.0 * (a[0][k] + 2.0 * a[1][k] + 2.0 * a[2][k] + a[3][k]);
        p->v[k] += h / 6.0 * (b[0][k] + 2.0 * b[1][k] + 2.0 * b[2][k] + b[3][k]);
    }
    p->t += h;
}

static void chatter(Plant *p, int k); /* a message for the log */

/* Do what is wrong; return the status: 0 fine, 2 discard, 3 error, 4 fatal, -1: none that there is. */
static int misbehave(Plant *p, double t) {
    static char *volatile nowhere = 0;
    if (p->fault == OK || t < p->fault_time - 1e-12 || p->stiffness < p->fault_above) return 0;
    switch (p->fault) {
        case SEGV: *nowhere = 1; break;
        case HANG: for (;;) sleep(1);
        case FAIL: return 3;
        case NOT_A_NUMBER: p->x[0] = NAN; break;
        case DISCARD: return 2;
        case HUNGRY:
            for (;;) {
                char *volatile more = malloc(64 << 20);
                memset(more, 1, 64 << 20);
            }
        case LEAVE: exit(3);
        case ABORT: fprintf(stderr, "assertion failed: the plant is tired\n"); abort();
        case PRINT: for (int k = 0; k < 20000; k++) printf("line %d of what nobody wants to read\n", k); break;
        case FLOOD:
            for (int k = 0; k < 100000 && !p->flooded; k++) chatter(p, k), printf("flood %d\n", k);
            p->flooded = 1;
            break;
        case LEAVE_WELL: exit(0);
        case FATAL: return 4;
        case BELOW: return -1;
        case CHILD: if (fork() == 0) for (;;) sleep(1); break;
    }
    return 0;
}

/* The ticks due at the present time. */
static void tick(Plant *p) {
    if (p->tick <= 0.0) return;
    if (!p->initialised) p->next = p->tick, p->initialised = 1;
    while (p->next <= p->t + 1e-12) p->count++, p->next += p->tick;
}

/* Bounce where the wall is passed; return whether something changed. */
static int bounce(Plant *p) {
    int changed = 0;
    for (int k = 0; k < N; k++)
        if (p->x[k] >= p->wall - 1e-9 && p->v[k] > 0.0) p->v[k] = -p->v[k], changed = 1;
    return changed;
}

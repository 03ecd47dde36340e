/* Runge-Kutta of order 4 from sample to sample. Steps end where something jumps: at the samples (what drives is held or
   linear between them) and a delay later; memory (plays, rate limits, delays) moves on at the end of each step. */
#include "effects.c"
#include "equations.c"

enum { INPUTS = 4, OUTPUTS = 4 };

typedef struct {
  int64_t plant, states, inputs, outputs, places, effects, samples, substeps, all_states;
  double rate;
  const double *parameters, *initial, *u, *series; /* u: samples x inputs */
  const int64_t *linear;                           /* of each input: linear between samples, else held */
  const effect *effect;
  double *y, *taps; /* samples x outputs, samples x places (or null) */
} run;

static int compare(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* Parts of a sample period where something jumps: its ends, and those of a delay or a jump. */
static int cuts(const run *r, double *cut) {
  int count = 0;
  cut[count++] = 0.0;
  for (int64_t i = 0; i < r->effects; ++i) {
    const effect *e = r->effect + i;
    const double when = e->law == DELAY ? e->p[0] : e->law == JUMP ? e->p[1] : 0.0;
    const double part = when * r->rate - floor(when * r->rate);
    if (part > 1e-7 && part < 1.0 - 1e-7) cut[count++] = part;
  }
  cut[count++] = 1.0;
  qsort(cut, (size_t)count, sizeof *cut, compare);
  return count;
}

static void evaluate(const run *r, machine *m, enum phase phase, int64_t k, double part, const double *x, double *dx,
                     double *y) {
  double u[INPUTS];
  for (int64_t i = 0; i < r->inputs; ++i) {
    const double now = r->u[k * r->inputs + i];
    u[i] = now;
    if (r->linear[i] && k + 1 < r->samples) u[i] += part * (r->u[(k + 1) * r->inputs + i] - now);
  }
  m->phase = phase;
  m->t = ((double)k + part) / r->rate;
  m->edge = (phase == BEGIN ? 1e-8 : phase == STAGE || phase == MIDDLE ? 0.0 : -1e-8) / r->rate;
  m->x = x;
  m->dx = dx;
  for (int64_t i = 0; i < r->all_states; ++i) dx[i] = 0.0;
  plants[r->plant](m, u, x, dx, y);
}

/* Simulate; return the number of samples until the motion diverged, all of them if it did not. */
int64_t simulate(const run *r) {
  kept *held = calloc(EFFECTS, sizeof *held);
  machine m = {.p = r->parameters, .effects = r->effects, .effect = r->effect, .kept = held, .series = r->series,
               .rate = r->rate, .samples = r->samples};
  const int64_t n = r->all_states;
  int64_t substeps = r->substeps, done = r->samples;
  double x[STATES] = {0}, z[STATES], k1[STATES], k2[STATES], k3[STATES], k4[STATES], y[OUTPUTS], cut[EFFECTS + 2];
  for (int64_t i = 0; i < r->effects; ++i)
    if (r->effect[i].law == DELAY) { /* a step is shorter than a delay */
      const double least = 1.0 / (r->rate * fmax(r->effect[i].p[0], 1e-3 / r->rate)) + 1.0;
      if (least > (double)substeps) substeps = (int64_t)least + 1;
    }
  const int corners = cuts(r, cut);
  for (int64_t i = 0; i < r->effects; ++i)
    if (r->effect[i].law == DELAY)
      held[i].past = malloc(sizeof(stretch) * (size_t)(r->samples * (substeps + corners) + 1));
  for (int64_t i = 0; i < r->states; ++i) x[i] = r->initial[i];
  evaluate(r, &m, START, 0, 0.0, x, k1, y);
  for (int64_t k = 0; k < r->samples; ++k) {
    m.step_begin = (double)k / r->rate;
    evaluate(r, &m, BEGIN, k, 0.0, x, k1, r->y + k * r->outputs);
    if (r->taps)
      for (int64_t i = 0; i < r->places; ++i) r->taps[k * r->places + i] = m.tap[i];
    double large = 0.0;
    for (int64_t i = 0; i < n; ++i) large += fabs(x[i]); /* not a number stays so */
    if (!(large < 1e12)) { done = k; break; }
    if (k + 1 == r->samples) break;
    for (int c = 0; c + 1 < corners; ++c) {
      const double length = cut[c + 1] - cut[c];
      const int64_t steps = (int64_t)ceil((double)substeps * length - 1e-6);
      const double part = length / (double)steps, h = part / r->rate;
      for (int64_t j = 0; j < steps; ++j) {
        const double begin = cut[c] + (double)j * part;
        m.step_begin = ((double)k + begin) / r->rate;
        evaluate(r, &m, BEGIN, k, begin, x, k1, y);
        for (int64_t i = 0; i < n; ++i) z[i] = x[i] + 0.5 * h * k1[i];
        evaluate(r, &m, STAGE, k, begin + 0.5 * part, z, k2, y);
        for (int64_t i = 0; i < n; ++i) z[i] = x[i] + 0.5 * h * k2[i];
        evaluate(r, &m, MIDDLE, k, begin + 0.5 * part, z, k3, y);
        for (int64_t i = 0; i < n; ++i) z[i] = x[i] + h * k3[i];
        evaluate(r, &m, LAST, k, begin + part, z, k4, y);
        for (int64_t i = 0; i < n; ++i) x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
        if (r->effects) evaluate(r, &m, END, k, begin + part, x, k1, y);
      }
    }
  }
  for (int i = 0; i < EFFECTS; ++i) free(held[i].past);
  free(held);
  return done;
}

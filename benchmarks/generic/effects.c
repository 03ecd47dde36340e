/* What a diagram may lack, as laws that change a signal v at a place: w = law(v). Definitions: laws.py, README.md. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

enum { PLACES = 32, STATES = 96, EFFECTS = 3, POLES = 40, PLAYS = 5 };

enum law { SATURATION, DEAD_ZONE, PLAY, FRICTION, CUBIC, QUADRATIC, ASYMMETRY, STOP, DELAY, RATE_LIMIT, LAG, MODE, LEAK,
           OFFSET, DRIFT, JUMP, LINE, SERIES, CROSS_TALK, GAIN_DRIFT, GAIN_SCHEDULE, QUANTISATION, BOUC_WEN, FRACTIONAL,
           PRANDTL, SELF_HEATING, RIPPLE };

enum phase { START, BEGIN, STAGE, MIDDLE, LAST, END }; /* before the run; the stages of a step; and where it ends */

typedef struct { double begin, width, value[3]; } stretch; /* a signal over one step: begin, middle, end */

typedef struct {
  int64_t law, place, other, state; /* state: index of its first own state; other: place of its argument */
  double p[6];
} effect;

typedef struct {
  double rest, memory[PLAYS], pole[POLES], weight[POLES], direct;
  int poles;
  stretch *past;
  int64_t stretches, near;
} kept;

typedef struct {
  const double *p, *x;
  double *dx, t, step_begin, edge; /* edge [s]: to which side of a jump a time belongs */
  enum phase phase;
  int64_t effects;
  const effect *effect;
  kept *kept;
  const double *series; /* values at the samples, linear in between */
  double rate;
  int64_t samples;
  double tap[PLACES];
} machine;

static double clamp(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

static double play(double v, double half, double kept_value) { return clamp(kept_value, v - half, v + half); }

/* The value a time tau ago, from the quadratics of the steps; before the run that at its start. */
static double delayed(machine *m, kept *k, double v, double tau) {
  if (m->phase == START) { k->rest = v; return v; }
  stretch *now = k->past + k->stretches;
  if (m->phase == BEGIN) *now = (stretch){m->t, 0.0, {v, v, v}};
  if (m->phase == MIDDLE) now->value[1] = v;
  if (m->phase == END) {
    now->value[2] = v;
    now->width = m->t - now->begin;
    k->stretches++;
  }
  const double when = m->t - tau + m->edge;
  if (when < 0.0 || k->stretches == 0) return k->rest;
  int64_t i = k->near < k->stretches ? k->near : k->stretches - 1;
  while (i > 0 && k->past[i].begin > when) --i;
  while (i + 1 < k->stretches && k->past[i + 1].begin <= when) ++i;
  k->near = i;
  const stretch *s = k->past + i;
  const double a = clamp((when - s->begin) / s->width, 0.0, 1.0);
  return s->value[0] * (1 - a) * (1 - 2 * a) + 4 * s->value[1] * a * (1 - a) + s->value[2] * a * (2 * a - 1);
}

/* 1 / (1 + sqrt(s T)) = int w(y) / (1 + s e^-y) dy, w = sqrt(z) / (pi (1 + z)), z = e^y T, by the trapezoidal rule;
   poles above 4 times the sample rate follow at once. */
static double fractional(machine *m, kept *k, const effect *e, double v) {
  if (m->phase == START) {
    const double dy = log(10.0) / 3.0, pi = acos(-1.0);
    double sum = 0.0, y = log(1e-5 / e->p[0]);
    for (k->poles = 0; k->poles < POLES && exp(y) < 4.0 * m->rate; y += dy, ++k->poles) {
      const double z = exp(y) * e->p[0], w = dy * sqrt(z) / (pi * (1.0 + z));
      k->pole[k->poles] = exp(y);
      k->weight[k->poles] = w;
      sum += w;
    }
    k->weight[0] += 2.0 / pi * sqrt(1e-5); /* the slower ones */
    k->direct = 1.0 - sum - 2.0 / pi * sqrt(1e-5);
    k->rest = v;
    return v;
  }
  const double *q = m->x + e->state;
  double *dq = m->dx + e->state, out = k->direct * v;
  for (int i = 0; i < k->poles; ++i) {
    dq[i] = k->pole[i] * (v - k->rest - q[i]);
    out += k->weight[i] * (q[i] + k->rest);
  }
  return out;
}

static double apply(machine *m, kept *k, const effect *e, double v) {
  const double *p = e->p, *q = m->x + e->state, t = m->t, other = m->tap[e->other];
  double *dq = m->dx + e->state;
  switch ((enum law)e->law) {
    case SATURATION: return clamp(v, -p[0], p[0]);
    case DEAD_ZONE: return v - clamp(v, -p[0], p[0]);
    case PLAY: {
      if (m->phase == START) return k->memory[0] = v;
      const double w = play(v, p[0], k->memory[0]);
      if (m->phase == END || m->phase == BEGIN) k->memory[0] = w; /* BEGIN: after a jump */
      return w;
    }
    case FRICTION: return v - p[0] * tanh(other / p[1]);
    case CUBIC: return v + p[0] * v * v * v;
    case QUADRATIC: return v + p[0] * v * v;
    case ASYMMETRY: return v + p[0] * fabs(v);
    case STOP: return v - p[1] * fmax(other - p[0], 0.0);
    case DELAY: return delayed(m, k, v, p[0]);
    case RATE_LIMIT: {
      if (m->phase == START) return k->memory[0] = v;
      const double far = p[0] * (t - m->step_begin), w = clamp(v, k->memory[0] - far, k->memory[0] + far);
      if (m->phase == END) k->memory[0] = w;
      return w;
    }
    case LAG:
      if (m->phase == START) return k->rest = v;
      dq[0] = (v - k->rest - q[0]) / p[0];
      return q[0] + k->rest;
    case MODE: /* w'' + 2 zeta p w' + p^2 w = p^2 v */
      if (m->phase == START) return k->rest = v;
      dq[0] = q[1];
      dq[1] = p[0] * p[0] * (v - k->rest - q[0]) - 2.0 * p[1] * p[0] * q[1];
      return q[0] + k->rest;
    case LEAK: return v - p[0] * other;
    case OFFSET: return v + p[0];
    case DRIFT: return v + p[0] * t;
    case JUMP: return v + p[0] * (t + m->edge >= p[1]);
    case LINE: return v + p[0] * sin(p[1] * t + p[2]);
    case SERIES: {
      const double at = t * m->rate;
      const int64_t i = (int64_t)clamp(floor(at), 0.0, (double)(m->samples - 2));
      return v + p[0] * (m->series[i] + (m->series[i + 1] - m->series[i]) * (at - (double)i));
    }
    case CROSS_TALK: return v + p[0] * other;
    case GAIN_DRIFT: return v * (1.0 + p[0] * t);
    case GAIN_SCHEDULE: return v * (1.0 + p[0] * other);
    case QUANTISATION: return p[0] * floor(v / p[0] + 0.5);
    case BOUC_WEN: { /* z' = o/d (1 - (1 + sgn(o z))/2 |z|^n); o: a velocity */
      const double z = q[0], size = p[2] == 1.0 ? fabs(z) : pow(fabs(z), p[2]);
      if (m->phase != START) dq[0] = other / p[1] * (1.0 - (other * z > 0.0 ? size : 0.0));
      return v - p[0] * z;
    }
    case FRACTIONAL: return fractional(m, k, e, v);
    case PRANDTL: { /* (1 - a) v + a mean of plays of half widths r, 2 r, ... */
      double sum = 0.0;
      for (int i = 0; i < PLAYS; ++i) {
        if (m->phase == START) k->memory[i] = v;
        const double w = play(v, p[1] * (i + 1), k->memory[i]);
        if (m->phase == END || m->phase == BEGIN) k->memory[i] = w;
        sum += w;
      }
      return (1.0 - p[0]) * v + p[0] * sum / PLAYS;
    }
    case SELF_HEATING: /* v (1 - a theta), tau theta' = (v/c)^2 - theta */
      if (m->phase == START) return k->rest = v;
      dq[0] = ((v * v - k->rest * k->rest) / (p[2] * p[2]) - q[0]) / p[1];
      return v * (1.0 - p[0] * q[0]);
    case RIPPLE: return v + p[0] * (sin(other / p[1] + p[2]) - sin(p[2]));
  }
  return v;
}

/* Return the signal v at a place, as it is with what acts there. */
static double at(machine *m, int place, double v) {
  for (int64_t i = 0; i < m->effects; ++i)
    if (m->effect[i].place == place) v = apply(m, m->kept + i, m->effect + i, v);
  return m->tap[place] = v;
}

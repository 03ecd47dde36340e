/* Rotating vectors instead of cosines and sines of angles that turn evenly; RS_NA angles, see turning.py.
 *
 * In m at RS_AT_TURN: the step at which the vectors are, the start and the length of the steps that they hold for, the
 * step at which they are set anew, and how: by rotation by the same or by a growing step, or not at all; then for every
 * angle RS_ANGLE numbers: cosine and sine of itself, of its step in half a step of the run, of what that grows by, and
 * what is left of the step. */
#define RS_BLOCK 256 /* steps: a vector that is rotated 512 times is off by 6e-14 */
#define RS_FEW 8 /* steps: setting the vectors costs about as much as the cosines and sines of these */
#define RS_STILL 1e-17 /* rad in a block: what a step grows by that is the same; a hundredth of what vectors are exact to */
enum { RS_TURN_AT, RS_TURN_T0, RS_TURN_H, RS_TURN_END, RS_TURN_KIND, RS_TURN_VECTORS };
enum { RS_NOT_EVEN, RS_SAME_STEP, RS_GROWING_STEP };

typedef struct {
  double hi, lo;
} rs_dd; /* the sum of both, |lo| <= half a unit in the last place of hi */

static const rs_dd rs_zero = {0.0, 0.0}, rs_one = {1.0, 0.0};
static const rs_dd rs_turn = {6.283185307179586, 2.4492935982947064e-16}; /* 2 pi */

static rs_dd rs_long(double a) {
  const rs_dd r = {a, 0.0};
  return r;
}
static rs_dd rs_sum(double a, double b) { /* exact */
  const double s = a + b, c = s - a;
  const rs_dd r = {s, (a - (s - c)) + (b - c)};
  return r;
}
static rs_dd rs_add(rs_dd a, rs_dd b) {
  const rs_dd s = rs_sum(a.hi, b.hi), t = rs_sum(a.lo, b.lo), u = rs_sum(s.hi, s.lo + t.hi);
  return rs_sum(u.hi, u.lo + t.lo);
}
static rs_dd rs_sub(rs_dd a, rs_dd b) {
  const rs_dd minus = {-b.hi, -b.lo};
  return rs_add(a, minus);
}
static rs_dd rs_mul(rs_dd a, rs_dd b) {
  const double p = a.hi * b.hi;
  return rs_sum(p, fma(a.hi, b.hi, -p) + (a.hi * b.lo + a.lo * b.hi));
}
static rs_dd rs_div(rs_dd a, rs_dd b) {
  const double q = a.hi / b.hi;
  const rs_dd r = rs_sub(a, rs_mul(rs_long(q), b));
  const double more = r.hi / b.hi;
  const rs_dd s = rs_sub(r, rs_mul(rs_long(more), b));
  return rs_add(rs_sum(q, more), rs_long(s.hi / b.hi));
}
/* Cases; held: which one holds. */
static rs_dd rs_less(rs_dd a, rs_dd b, char *held) {
  *held = a.hi < b.hi || (a.hi == b.hi && a.lo < b.lo);
  return *held ? rs_one : rs_zero;
}
static rs_dd rs_less_equal(rs_dd a, rs_dd b, char *held) {
  *held = a.hi < b.hi || (a.hi == b.hi && a.lo <= b.lo);
  return *held ? rs_one : rs_zero;
}
static rs_dd rs_min(rs_dd a, rs_dd b, char *held) { return rs_less_equal(a, b, held).hi != 0.0 ? a : b; }
static rs_dd rs_max(rs_dd a, rs_dd b, char *held) { return rs_less_equal(a, b, held).hi != 0.0 ? b : a; }

static void rs_angles(rs_dd t, const double *p, rs_dd *angle, char *held);

/* Cosine and sine of an angle. */
static void rs_vector(rs_dd a, double *v) {
  const double turns = nearbyint(a.hi / rs_turn.hi);
  const rs_dd r = rs_sub(a, rs_mul(rs_long(turns), rs_turn));
  const double c = cos(r.hi), s = sin(r.hi);
  v[0] = c - r.lo * s, v[1] = s + r.lo * c;
}

/* Rotate a vector; let the step of an angle grow, the digits that its vector has no room for carried on: rounding of
 * steps adds up in the angle. Of what it grows by the first is the cosine less one: beside 1 it has no digits left. */
#define RS_ROTATIONS(type, name)                                                                          \
  static inline void rs_rotate##name(type *v, const type *by) {                                           \
    const type c = v[0] * by[0] - v[1] * by[1];                                                           \
    v[1] = v[1] * by[0] + v[0] * by[1], v[0] = c;                                                         \
  }                                                                                                       \
  static inline void rs_grow##name(type *step, const type *by, type *rest) {                              \
    const type more[2] = {(step[0] * by[0] - step[1] * by[1]) + rest[0],                                  \
                          (step[1] * by[0] + step[0] * by[1]) + rest[1]};                                 \
    for (int i = 0; i < 2; ++i) {                                                                         \
      const type sum = step[i] + more[i], added = sum - step[i];                                          \
      rest[i] = (step[i] - (sum - added)) + (more[i] - added), step[i] = sum;                             \
    }                                                                                                     \
  }
RS_ROTATIONS(double, )

/* Half a step on. */
static void rs_turn_on(double *turn) {
  double *v = turn + RS_TURN_VECTORS;
  for (int k = 0; k < RS_NA; ++k) rs_rotate(v + RS_ANGLE * k, v + RS_ANGLE * k + 2);
  if (turn[RS_TURN_KIND] == RS_GROWING_STEP)
    for (int k = 0; k < RS_NA; ++k) rs_grow(v + RS_ANGLE * k + 2, v + RS_ANGLE * k + 4, v + RS_ANGLE * k + 6);
}

/* Set the vectors at step n, until the next whole block: a parabola through both ends and the middle of it, where all
 * cases that hold at one end hold at the other. */
static void rs_turn_set(double *turn, const double *p, double t0, double h, int64_t n) {
  const int64_t end = (n / RS_BLOCK + 1) * RS_BLOCK;
  const double m = (double)(end - n); /* half of the half steps */
  rs_dd angle[3][RS_NA];
  char held[3][RS_CASES + 1] = {{0}};
  turn[RS_TURN_END] = (double)end, turn[RS_TURN_KIND] = RS_NOT_EVEN;
  for (int i = 0; i < 3; ++i) {
    const rs_dd steps = rs_sum((double)n, 0.5 * i * m);
    rs_angles(rs_add(rs_long(t0), rs_mul(steps, rs_long(h))), p, angle[i], held[i]);
    if (memcmp(held[i], held[0], RS_CASES)) return;
  }
  int kind = RS_SAME_STEP;
  for (int k = 0; k < RS_NA; ++k) {
    const rs_dd first = rs_sub(angle[1][k], angle[0][k]), second = rs_sub(rs_sub(angle[2][k], angle[1][k]), first);
    double *v = turn + RS_TURN_VECTORS + RS_ANGLE * k;
    rs_dd step = rs_div(first, rs_long(m));
    v[4] = v[5] = v[6] = v[7] = 0.0;
    if (!(fabs(second.hi) <= RS_STILL)) { /* or no number */
      const rs_dd grow = rs_div(second, rs_long(m * m)); /* second difference of half steps */
      step = rs_sub(step, rs_mul(grow, rs_long(0.5 * (m - 1.0))));
      rs_vector(grow, v + 4);
      v[4] = -2.0 * sin(0.5 * grow.hi) * sin(0.5 * grow.hi);
      kind = RS_GROWING_STEP;
    }
    rs_vector(angle[0][k], v), rs_vector(step, v + 2);
    for (int i = 0; i < 6; ++i)
      if (v[i] != v[i]) return; /* an angle that is no number, as the library then finds, too */
  }
  turn[RS_TURN_KIND] = kind;
}

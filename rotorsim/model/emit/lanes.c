/* The C runtime of an ensemble: RS_LANES runs side by side, which differ in parameters, states and the length of their
 * steps; what is wanted of each is reduced while they run. It is appended to the generated functions and layout.h.
 *
 * Runs begin at t = 0. With samplers (RS_NS) their periods and the steps are those of lane 0. */

/* What is kept of the rows. A segment of rows: the least and the largest, the sum and the sum of squares of all columns.
 * In the window of rows first .. last - 1: sums of cosines and sines of multiples of the angle, alone and times the
 * columns; the columns where the angle passes whole turns, by the cubic through four rows; the rows themselves. */
typedef struct {
  int64_t row;                       /* number of the next one */
  int64_t n_segments, segment;       /* of all, of the present one */
  const int64_t *end;                /* (n_segments): the row behind each */
  rs_lanes *moments;                 /* (n_segments, 4, NY) */
  int64_t first, last;               /* the window */
  int64_t n_orders, cosine, sine;    /* columns with cosine and sine of the angle */
  rs_lanes *sums;                    /* (2, 2 n_orders + 1): of cosines, of sines */
  rs_lanes *products;                /* (2, n_orders + 1, NY): cosines, sines times columns */
  int64_t angle, n_points;           /* column of the angle [rad]; most points, 0 for none */
  double *points;                    /* (lanes, n_points, NY) */
  int64_t *found;                    /* (lanes), those without room among them */
  rs_lanes *recent;                  /* (4, NY), row k at k % 4, and the turns of the last two rows */
  rs_lanes *history;                 /* (last - first, NY), or null */
  rs_lanes *latest;                  /* (NY): the last row */
  rs_lanes *steepest;                /* what the angle goes at most from one row to the next, where points are kept */
} rs_reduction;

RS_EXPORT int64_t rs_size(void) { return RS_SIZE; }

/* Compute everything that depends on parameters only. */
RS_EXPORT void rs_prepare(const rs_lanes *p, rs_lanes *m) {
  rs_constants(p, m + RS_AT_C, m + RS_AT_WORK);
  m[RS_AT_D] = rs_all(NAN); /* of no step */
}

static int rs_any(rs_mask here) {
  int any = 0;
  for (int k = 0; k < RS_LANES; ++k) any |= here[k] != 0;
  return any;
}

/* Have what follows from the length of a step. */
static const rs_lanes *rs_step_of(rs_lanes h, const rs_lanes *p, rs_lanes *m) {
#if RS_ND > 0
  if (rs_any(m[RS_AT_D] != h)) rs_step_constants(h, p, m + RS_AT_C, m + RS_AT_D + 1, m + RS_AT_WORK);
#endif
  m[RS_AT_D] = h;
  (void)p;
  return m + RS_AT_D + 1;
}

#if RS_NS > 0
static double rs_next_hit(const double *p, const rs_lanes *m) {
  double next = HUGE_VAL;
  for (int s = 0; s < RS_NS; ++s) {
    const double at = m[RS_AT_COUNT + s][0] * p[rs_period[s]];
    if (at < next) next = at;
  }
  return next;
}

/* Carry out the hits that are due at time t in all lanes; each: parameters lane by lane. */
static void rs_hit(double t, const rs_lanes *p, const double *each, rs_lanes *m, const rs_lanes *g) {
  int any = 0;
  for (int s = 0; s < RS_NS; ++s) {
    const double period = each[rs_period[s]], count = m[RS_AT_COUNT + s][0];
    const int due = count * period <= t + 1e-9 * period;
    m[RS_AT_HIT + s] = rs_all((double)due);
    if (!due) continue;
    any = 1;
    for (int j = rs_draw_begin[s]; j < rs_draw_end[s]; ++j)
      for (int k = 0; k < RS_LANES; ++k)
        m[RS_AT_W + j][k] =
            rs_normal((uint64_t)(int64_t)each[k * RS_NP + rs_seed[s]], (uint64_t)count, (uint64_t)(j - rs_draw_begin[s]));
    m[RS_AT_COUNT + s] = rs_all(count + 1.0);
  }
  if (!any) return;
  rs_update(m + RS_AT_X, m + RS_AT_Z, p, m + RS_AT_C, g, m + RS_AT_W, m + RS_AT_HIT, m + RS_AT_NEW, m + RS_AT_WORK);
  memcpy(m + RS_AT_Z, m + RS_AT_NEW, RS_NZ * sizeof(rs_lanes));
}
#endif

/* Begin at t = 0: forcing of this instant, sample hits due. The states are in m already. */
RS_EXPORT void rs_start(const rs_lanes *p, const double *each, rs_lanes *m) {
#if RS_NA > 0
  m[RS_AT_TURN + RS_TURN_H] = rs_all(NAN);
#endif
  rs_forcing(rs_zeros, p, m + RS_AT_C, m + RS_AT_G, m + RS_AT_WORK);
#if RS_NS > 0
  for (int s = 0; s < RS_NS; ++s) m[RS_AT_COUNT + s] = rs_zeros;
  rs_hit(0.0, p, each, m, m + RS_AT_G);
#else
  (void)each;
#endif
}

#if RS_NA > 0
/* Set the vectors of all lanes at step n, for the steps of each. */
static void rs_turn_set_all(rs_lanes *turn, const double *each, rs_lanes h, int64_t n) {
  double one[RS_TURN_VECTORS + RS_ANGLE * RS_NA] = {0};
  for (int k = 0; k < RS_LANES; ++k) {
    rs_turn_set(one, each + k * RS_NP, 0.0, h[k], n);
    turn[RS_TURN_END][k] = one[RS_TURN_END], turn[RS_TURN_KIND][k] = one[RS_TURN_KIND];
    for (int i = 0; i < RS_ANGLE * RS_NA; ++i) turn[RS_TURN_VECTORS + i][k] = one[RS_TURN_VECTORS + i];
  }
}

RS_ROTATIONS(rs_lanes, _all)

/* How the vectors of the lanes turn: how many evenly, how many with a growing step. */
typedef struct {
  int even, growing;
} rs_turns;

/* Forcing of the next half step: by rotation in the lanes where the angles turn evenly. */
static inline void rs_forcing_next(rs_lanes *turn, rs_turns how, rs_lanes t, const rs_lanes *p, const rs_lanes *c,
                                   rs_lanes *g, rs_lanes *work) {
  rs_lanes *v = turn + RS_TURN_VECTORS;
  for (int k = 0; k < RS_NA; ++k) rs_rotate_all(v + RS_ANGLE * k, v + RS_ANGLE * k + 2);
  if (how.growing) /* by nothing, where they do not */
    for (int k = 0; k < RS_NA; ++k) rs_grow_all(v + RS_ANGLE * k + 2, v + RS_ANGLE * k + 4, v + RS_ANGLE * k + 6);
  rs_forcing_turned(t, p, c, v, g, work);
  if (how.even == RS_LANES) return;
  const rs_mask even = turn[RS_TURN_KIND] != rs_all((double)RS_NOT_EVEN);
  rs_lanes asked[RS_NG + 1];
  rs_forcing(t, p, c, asked, work);
  for (int i = 0; i < RS_NG; ++i) g[i] = rs_either(even, g[i], asked[i]);
}
#endif

/* Whole turns of the angle of a row. */
static rs_lanes rs_turns_of(const rs_reduction *r, const rs_lanes *row) { return rs_floor(row[r->angle] / 6.283185307179586); }

/* The columns where the angle of lanes has passed a whole turn between two rows, by the last four rows. */
static void rs_section(rs_reduction *r, rs_lanes before, rs_lanes after) {
  const rs_mask passed = before != after;
  if (!rs_any(passed)) return;
  for (int k = 0; k < RS_LANES; ++k) {
    if (!passed[k] || r->found[k]++ >= r->n_points) continue;
    const double at = 6.283185307179586 * (before[k] > after[k] ? before[k] : after[k]);
    double weight[4], *point = r->points + (k * r->n_points + r->found[k] - 1) * RS_NY;
    for (int i = 0; i < 4; ++i) {
      weight[i] = 1.0;
      const double here = r->recent[i * RS_NY + r->angle][k];
      for (int j = 0; j < 4; ++j) {
        const double other = r->recent[j * RS_NY + r->angle][k];
        if (j != i) weight[i] *= (at - other) / (here - other);
      }
    }
    for (int y = 0; y < RS_NY; ++y) {
      point[y] = 0.0;
      for (int i = 0; i < 4; ++i) point[y] += weight[i] * r->recent[i * RS_NY + y][k];
    }
  }
}

/* Take row n of the window for sections: that between the two rows before it, first and last (no row) that at the ends. */
static void rs_passed(rs_reduction *r, int64_t n, const rs_lanes *row) {
  rs_lanes *turn = r->recent + 4 * RS_NY;
  if (row) {
    if (n > r->first) {
      const rs_lanes by = rs_fabs(row[r->angle] - r->recent[((n - 1) & 3) * RS_NY + r->angle]);
      *r->steepest = rs_either(*r->steepest > by, *r->steepest, by);
    }
    memcpy(r->recent + (n & 3) * RS_NY, row, RS_NY * sizeof(rs_lanes));
    if (n - r->first == 3) rs_section(r, rs_turns_of(r, r->recent + (r->first & 3) * RS_NY), turn[0]);
  }
  if (n - r->first >= (row ? 3 : 4)) rs_section(r, turn[0], turn[1]);
  turn[0] = turn[1];
  if (row) turn[1] = rs_turns_of(r, row);
}

/* Take one row. */
static void rs_reduce(rs_reduction *r, const rs_lanes *row) {
  const int64_t n = r->row++;
  if (r->segment < r->n_segments) {
    rs_lanes *at = r->moments + r->segment * 4 * RS_NY;
    for (int y = 0; y < RS_NY; ++y) {
      const rs_lanes v = row[y];
      at[y] = rs_either(at[y] < v, at[y], v);
      at[RS_NY + y] = rs_either(at[RS_NY + y] > v, at[RS_NY + y], v);
      at[2 * RS_NY + y] += v;
      at[3 * RS_NY + y] += v * v;
    }
    if (n + 1 >= r->end[r->segment]) ++r->segment;
  }
  if (n < r->first || n >= r->last) return;
  if (r->history) memcpy(r->history + (n - r->first) * RS_NY, row, RS_NY * sizeof(rs_lanes));
  if (r->n_orders >= 0) {
    const int64_t most = 2 * r->n_orders;
    const rs_lanes by_c = row[r->cosine], by_s = row[r->sine];
    rs_lanes c = rs_all(1.0), s = rs_zeros;
    for (int64_t k = 0; k <= most; ++k) {
      r->sums[k] += c, r->sums[most + 1 + k] += s;
      if (k <= r->n_orders)
        for (int y = 0; y < RS_NY; ++y) {
          r->products[k * RS_NY + y] += c * row[y];
          r->products[(r->n_orders + 1 + k) * RS_NY + y] += s * row[y];
        }
      const rs_lanes next = c * by_c - s * by_s;
      s = s * by_c + c * by_s, c = next;
    }
  }
  if (r->n_points) rs_passed(r, n, row);
}

/* Keep the row that was taken last. */
static void rs_latest(rs_reduction *r, const rs_lanes *row) { memcpy(r->latest, row, RS_NY * sizeof(rs_lanes)); }

/* Take the row at the end of a run, which stands at step n with steps h, and what only the end decides. */
RS_EXPORT void rs_end(const rs_lanes *p, rs_lanes *m, int64_t with_row, rs_reduction *r) {
  if (with_row) {
    rs_outputs(m + RS_AT_X, m + RS_AT_Z, p, m + RS_AT_C, m + RS_AT_G, m + RS_AT_ROW, m + RS_AT_WORK);
    rs_reduce(r, m + RS_AT_ROW);
    rs_latest(r, m + RS_AT_ROW);
  }
  if (r->n_points) rs_passed(r, r->row, 0);
}

/* Which lanes have states within all bounds. */
static rs_mask rs_bounded(const rs_lanes *x) {
  rs_lanes a = rs_zeros, b = rs_zeros;
  int i = 0;
  for (; i + 1 < RS_NX; i += 2) a += rs_fabs(x[i]), b += rs_fabs(x[i + 1]);
  if (i < RS_NX) a += rs_fabs(x[i]);
  return a + b <= rs_all(RS_LARGEST);
}

/* Run steps n0..n1-1 of lengths h; every `every`-th row is taken, at the start of a step.
 * failed (lanes): the step by whose end a lane has left all bounds, where it was 0. Returns the step reached. */
RS_EXPORT int64_t rs_run(const rs_lanes *p, const double *each, rs_lanes *m, int64_t n0, int64_t n1, const rs_lanes *step,
                         int64_t every, rs_reduction *r, int64_t *failed) {
  if (n0 >= n1) return n0;
#if RS_UNROLLED && RS_NX > 0
  rs_lanes x[RS_NX];
  memcpy(x, m + RS_AT_X, sizeof x);
#else
  rs_lanes *x = m + RS_AT_X;
#endif
  rs_lanes *z = m + RS_AT_Z, *c = m + RS_AT_C, *work = m + RS_AT_WORK, *k = m + RS_AT_K;
  rs_lanes *const row = m + RS_AT_ROW, unused[RS_NY + 1]; /* what is taken, and what is not */
  const int64_t taken = r->row;
  rs_lanes *g0 = m + RS_AT_G, *gm = g0 + RS_NG, *g1 = gm + RS_NG;
  const rs_lanes h = *step;
#if RS_NS == 0
  const rs_lanes *d = rs_step_of(h, p, m);
#endif
#if RS_NA > 0
  rs_lanes turn[RS_TURN_VECTORS + RS_ANGLE * RS_NA];
  memcpy(turn, m + RS_AT_TURN, sizeof turn);
  rs_turns how = {0, 0};
  int fresh = 1;
  if (turn[RS_TURN_AT][0] != (double)n0 || rs_any(turn[RS_TURN_H] != h)) turn[RS_TURN_END] = rs_all((double)n0);
#endif
  int64_t n = n0, until_row = (every - n0 % every) % every;
  for (; n < n1; ++n) {
    const int wanted = until_row == 0;
    if (wanted) until_row = every;
    --until_row;
#if RS_NS > 0
    double t = (double)n * h[0];
    const double end = (double)(n + 1) * h[0];
    for (int first = 1;; first = 0) {
      double stop = rs_next_hit(each, m);
      if (stop > end - 1e-9 * h[0]) stop = end;
      rs_forcing(rs_all(t + 0.5 * (stop - t)), p, c, gm, work);
      rs_forcing(rs_all(stop), p, c, g1, work);
      rs_step(rs_all(stop - t), x, z, p, c, g0, gm, g1, rs_step_of(rs_all(stop - t), p, m),
              first && wanted ? row : unused, k, work);
      if (first && wanted) rs_reduce(r, row);
      rs_lanes *swap = g0;
      g0 = g1, g1 = swap;
#if RS_UNROLLED && RS_NX > 0
      memcpy(m + RS_AT_X, x, sizeof x);
#endif
      rs_hit(stop, p, each, m, g0);
      if (stop == end) break;
      t = stop;
    }
#else
    const rs_lanes middle = ((double)n + 0.5) * h, end = (double)(n + 1) * h;
#if RS_NA > 0
    if ((double)n >= turn[RS_TURN_END][0]) rs_turn_set_all(turn, each, h, n), fresh = 1;
    if (fresh) {
      fresh = how.even = how.growing = 0;
      for (int i = 0; i < RS_LANES; ++i) {
        how.even += turn[RS_TURN_KIND][i] != RS_NOT_EVEN;
        how.growing += turn[RS_TURN_KIND][i] == RS_GROWING_STEP;
      }
    }
    rs_forcing_next(turn, how, middle, p, c, gm, work);
    rs_forcing_next(turn, how, end, p, c, g1, work);
#else
    rs_forcing(middle, p, c, gm, work);
    rs_forcing(end, p, c, g1, work);
#endif
    rs_step(h, x, z, p, c, g0, gm, g1, d, wanted ? row : unused, k, work);
    if (wanted) rs_reduce(r, row);
    rs_lanes *swap = g0;
    g0 = g1, g1 = swap;
#endif
    if ((n & 7) == 7) {
      const rs_mask bounded = rs_bounded(x);
      if (rs_any(~bounded)) {
        int n_failed = 0;
        for (int i = 0; i < RS_LANES; ++i) {
          if (!bounded[i] && !failed[i]) failed[i] = n + 1;
          n_failed += failed[i] != 0;
        }
        if (n_failed == RS_LANES) {
          ++n;
          break;
        }
      }
    }
  }
  if (r->row > taken) rs_latest(r, row);
#if RS_UNROLLED && RS_NX > 0
  memcpy(m + RS_AT_X, x, sizeof x);
#endif
#if RS_NA > 0
  turn[RS_TURN_AT] = rs_all((double)n), turn[RS_TURN_H] = h;
  memcpy(m + RS_AT_TURN, turn, sizeof turn);
#endif
  if (g0 != m + RS_AT_G) { /* the forcing of the current instant stays in front */
    for (int i = 0; i < RS_NG; ++i) {
      const rs_lanes swap = g0[i];
      g0[i] = m[RS_AT_G + i], m[RS_AT_G + i] = swap;
    }
  }
  return n;
}

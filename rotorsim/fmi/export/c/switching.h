/* Events of the FMUs inside: handed over to an importer that integrates (model exchange), located and carried out within
 * the steps of co-simulation, as rotorsim/simulation/event_steps.py and switching.py do. It is a part of stepping.h. */

#define RF_LOCATED 1e-12 /* numbers: those of event_steps.py, where they are explained */
#define RF_TOUCH 1e-10
#define RF_CHATTER 1e-8
#define RF_MOST_EVENTS 1000
#define RF_MOST_ITERATIONS 100

static double rf_larger(double a, double b) { return a > b ? a : b; }

static double rf_next_event(const rf_instance *i) {
  double next = HUGE_VAL;
  for (int k = 0; k < RF_NESTED; ++k)
    if (i->inner[k].fmu.n_x && i->inner[k].at.due < next) next = i->inner[k].at.due;
  return next;
}

/* Let the FMUs see the present point; return whether it failed. */
static int rf_see(rf_instance *i) {
  rf_soil(i, RF_STALE_RATE);
  rf_rates(i);
  for (int k = 0; k < RF_NESTED && i->status < RF_DISCARD; ++k) {
    rf_inner *n = i->inner + k;
    for (int j = 0; j < n->fmu.n_z; ++j)
      if (!(n->fmu.seen[n->fmu.n_u + j] - n->fmu.seen[n->fmu.n_u + j] == 0.0))
        return rf_failed(n, RF_ERROR, "gives %g for event indicator %d", n->fmu.seen[n->fmu.n_u + j], j + 1);
  }
  return i->status >= RF_DISCARD;
}

/* Put the event indicators at the present point into z, all one behind the other; return whether it failed. */
static int rf_look(rf_instance *i, double *z) {
  if (rf_see(i)) return 1;
  for (int k = 0; k < RF_NESTED; ++k) {
    const rs_fmu *f = &i->inner[k].fmu;
    memcpy(z, f->seen + f->n_u, (size_t)f->n_z * sizeof *z);
    z += f->n_z;
  }
  return 0;
}

static int rf_has_crossed(const rf_instance *i, const double *z, int k) {
  return i->at.sides[k] > 0.0 ? z[k] <= 0.0 : z[k] > 0.0;
}

static int rf_any_crossed(const rf_instance *i, const double *z) {
  for (int k = 0; k < RF_NESTED_Z; ++k)
    if (rf_has_crossed(i, z, k)) return 1;
  return 0;
}

static int rf_take_sides(rf_instance *i) {
  double z[RF_NESTED_Z + 1];
  if (rf_look(i, z)) return 1;
  i->at.touching = 0;
  for (int k = 0; k < RF_NESTED_Z; ++k) {
    i->at.sides[k] = z[k] > 0.0 ? 1.0 : -1.0;
    i->at.touching |= z[k] == 0.0;
  }
  return 0;
}

/* Bring an FMU to the present point, as it was seen last. */
static int rf_bring(rf_inner *n) {
  rs_fmu *f = &n->fmu;
  void *c = n->at.instance;
  n->time = n->outer->d[RF_TIME];
  if (rf_wrong(n, "SetTime", ((time_)f->set_time)(c, n->time))) return 1;
  if (rf_wrong(n, "SetContinuousStates",
               ((set_)f->set_x)(c, rf_x(n->outer) + n->model->at_x, (size_t)f->n_x)))
    return 1;
  return f->n_u && rf_wrong(n, f->version == 2 ? "SetReal" : "SetFloat64",
                            access_real(f, f->set_real, c, 0, f->seen, f->n_u));
}

/* Carry out an event of all FMUs, and more of those whose inputs it has changed; return whether it failed or ended. */
static int rf_carry_out(rf_instance *i) {
  double *fed[RF_NESTED] = {0};
  int left = 1, wrong = rf_see(i);
  for (int count = 0; left && !wrong; ++count) {
    left = 0;
    for (int k = 0; k < RF_NESTED && !wrong; ++k) {
      rf_inner *n = i->inner + k;
      const size_t size = (size_t)n->fmu.n_u * sizeof(double);
      if (!n->fmu.n_x || (fed[k] && !memcmp(fed[k], n->fmu.seen, size))) continue;
      if (count == RF_MOST_ITERATIONS) {
        wrong = rf_failed(n, RF_ERROR, "the FMUs change one another %d times at one event", RF_MOST_ITERATIONS);
        break;
      }
      if (!fed[k]) fed[k] = (double *)malloc(size + 1);
      if (!fed[k]) {
        wrong = rf_failed(n, RF_ERROR, "not enough memory");
        break;
      }
      memcpy(fed[k], n->fmu.seen, size);
      left = 1;
      wrong = rf_bring(n) || rf_plainly(n, "EnterEventMode") || rf_settle(n) || i->ended;
      if (!wrong) memcpy(rf_x(i) + n->model->at_x, n->x, (size_t)n->fmu.n_x * sizeof(double));
    }
    rf_soil(i, RF_STALE_VALUES);
    if (!wrong) wrong = rf_see(i);
  }
  for (int k = 0; k < RF_NESTED; ++k) free(fed[k]);
  return wrong;
}

/* Tell of a completed step; return whether an event is wanted. */
static int rf_completed(rf_instance *i, int no_set_state) {
  typedef int (*completed2)(void *, int, int *, int *);
  typedef int (*completed3)(void *, bool, bool *, bool *);
  int wants = 0;
  if (!RF_REPORTS || rf_see(i)) return 0;
  for (int k = 0; k < RF_NESTED; ++k) {
    rf_inner *n = i->inner + k;
    int event = 0, end = 0;
    bool event3 = false, end3 = false;
    if (!n->fmu.n_x || !n->model->reports) continue;
    if (rf_bring(n)) return 0;
    const rf_function function = rf_find(n, "CompletedIntegratorStep");
    if (rf_wrong(n, "CompletedIntegratorStep",
                 n->model->version == 2 ? ((completed2)function)(n->at.instance, no_set_state, &event, &end)
                                        : ((completed3)function)(n->at.instance, no_set_state, &event3, &end3)))
      return 0;
    wants |= event || event3;
    i->ended |= end || end3;
  }
  return wants;
}

/* ---- model exchange ---- */

/* Carry out what the importer has come for; the first time, behind the initialisation, what is due. */
static void rf_update_inners(rf_instance *i) {
  double z[RF_NESTED_Z + 1];
  const int first = !i->at.begun;
  i->at.begun = 1;
  for (int k = 0; k < RF_NESTED; ++k) i->inner[k].states = i->inner[k].nominals = 0;
  if (first && rf_look(i, z)) return;
  if (first && rf_next_event(i) > i->d[RF_TIME] && !rf_any_crossed(i, z)) return;
  if (!rf_carry_out(i)) rf_take_sides(i);
}

/* ---- co-simulation ---- */

static int rf_endless(rf_instance *i, const char *what) {
  if (i->status < RF_ERROR) i->status = RF_ERROR;
  return rf_log(i, RF_ERROR, "%s (t = %.9g s): events accumulate: a contact that comes to rest, or a relay without hysteresis",
                what, i->d[RF_TIME]);
}

/* Carry out the event at t, and more while the next one is due at once. */
static int rf_events(rf_instance *i, double t, double tiny) {
  for (int count = 0; count < RF_MOST_EVENTS; ++count) {
    const double next = rf_next_event(i);
    i->at.clock = next <= t + tiny ? rf_larger(t, next) : t;
    rf_set_time(i, i->at.clock);
    if (rf_carry_out(i)) return 1;
    rf_log(i, RF_OK, "event at t = %.9g s", t);
    if (rf_next_event(i) > t + tiny) return rf_take_sides(i);
  }
  return rf_endless(i, "the next time event is due at once, again and again");
}

static int rf_begin_switching(rf_instance *i) {
  double z[RF_NESTED_Z + 1];
  const double t = i->d[RF_TIME];
  i->at.clock = -HUGE_VAL;
  for (int k = 0; k < 2 * RF_NESTED_Z; ++k) i->at.last[k] = -HUGE_VAL;
  if (rf_look(i, z)) return 1;
  return rf_next_event(i) <= t || rf_any_crossed(i, z) ? rf_events(i, t, 0.0) : rf_take_sides(i);
}

/* From what is held, take a step by width from t; row n of the grid from t0, or none. Return whether it failed. */
static int rf_try(rf_instance *i, double t, double width, int whole, int64_t n, double t0, double *z) {
  memcpy(i->d, i->held, sizeof i->d);
  if (width > 0.0) {
    if (whole) rs_run(rf_p(i), rf_m(i), n, n + 1, t0, width, INT64_MAX, i->row);
    else rs_run(rf_p(i), rf_m(i), 0, 1, t, width, INT64_MAX, i->row);
  }
  i->d[RF_TIME] = whole ? t0 + (double)(n + 1) * width : t + width;
  rf_soil(i, RF_STALE_VALUES);
  return i->status >= RF_DISCARD || (RF_NESTED_Z && rf_look(i, z));
}

/* Refuse crossings that come back at once. */
static int rf_note(rf_instance *i, const double *z, double t, double h) {
  for (int k = 0; k < RF_NESTED_Z; ++k) {
    double *last = i->at.last + 2 * k + (i->at.sides[k] > 0.0);
    if (!rf_has_crossed(i, z, k)) continue;
    if (t - *last < rf_larger(RF_CHATTER * h, 100.0 * DBL_EPSILON * fabs(t)))
      return rf_endless(i, "an event indicator crosses zero again and again");
    *last = t;
  }
  return 0;
}

/* Take step n of size h of the grid from t0, from event to event; return whether it failed or ended. */
static int rf_step_over(rf_instance *i, int64_t n, double t0, double h) {
  double z[RF_NESTED_Z + 1], t = t0 + (double)n * h;
  const double start = t, end = t0 + (double)(n + 1) * h, tiny = rf_larger(1e-10 * h, 8.0 * DBL_EPSILON * fabs(t));
  int events = 0;
  if (i->at.clock > t && i->at.clock - t <= 1e-9 * rf_larger(fabs(t), 1.0)) t = i->at.clock; /* time never goes back */
  while (t < end - tiny) {
    const double next = rf_next_event(i);
    double goal = next < end - tiny ? next : end;
    if (i->at.touching) { /* which side it takes is seen before it may come back */
      const double soon = t + rf_larger(RF_TOUCH * h, 1e3 * DBL_EPSILON * fabs(t));
      goal = soon < goal ? soon : goal;
      i->at.touching = 0;
    }
    int whole = t == start && goal == end;
    double width = whole ? h : goal - t;
    memcpy(i->held, i->d, sizeof i->d);
    if (rf_try(i, t, width, whole, n, t0, z)) return 1;
    const int crossed = rf_any_crossed(i, z);
    if (crossed) {
      double before = 0.0, behind = width;
      const double close = rf_larger(RF_LOCATED * h, 2.0 * DBL_EPSILON * fabs(t));
      while (behind - before > close) {
        const double middle = before + 0.5 * (behind - before);
        if (rf_try(i, t, middle, 0, n, t0, z)) return 1;
        if (rf_any_crossed(i, z)) behind = middle;
        else before = middle;
      }
      if (rf_try(i, t, behind, 0, n, t0, z)) return 1;
      goal = t + behind;
    }
    t = goal;
    rf_set_time(i, t);
    const int wants = rf_completed(i, 1);
    if (i->status >= RF_DISCARD || i->ended) return 1;
    if (crossed || wants) {
      if (++events > RF_MOST_EVENTS) return rf_endless(i, "there are too many events in one step");
      if (rf_note(i, z, t, h) || rf_events(i, t, tiny)) return 1;
    } else if (rf_next_event(i) <= t + tiny && rf_events(i, t, tiny)) {
      return 1;
    }
  }
  return 0;
}

/* Directional derivatives, forward and adjoint: they follow instance.h. */

#if RF_NESTED /* not offered: those inside may have none */
static int rf_directional(rf_instance *i, const char *function, const unsigned *unknowns, size_t n_unknowns,
                          const unsigned *knowns, size_t n_knowns, const double *seed, long long n_seed, double *result,
                          long long n_result, int forward) {
  (void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)result, (void)n_result;
  (void)forward;
  return rf_log(i, RF_ERROR, "%s: this FMU holds other FMUs and offers no derivatives", function);
}

static int rf_output_rates(rf_instance *i, const char *function, const unsigned *references, size_t n,
                           const int *orders, double *values, long long n_values) {
  (void)references, (void)n, (void)orders, (void)values, (void)n_values;
  return rf_log(i, RF_ERROR, "%s: this FMU holds other FMUs and offers no derivatives", function);
}
#else

/* ---- derivatives of [state derivatives; outputs; events] by [states; discrete states and inputs; time; parameters];
   in initialization mode states that follow from parameters are carried along, and states are unknowns too ---- */

#define RF_SEED_Z RS_NX
#define RF_SEED_TIME (RS_NX + RS_NZ)
#define RF_SEED_P RF_N_KNOWN

static int rf_beginning(const rf_instance *i) { return (int)i->d[RF_PHASE] == RF_INITIALISING; }

/* The place of an unknown in result, -1 for what is none now. */
static int rf_row(const rf_instance *i, unsigned k) {
  if (k >= RF_AT_OUTPUT && k < RF_AT_STATE) return RS_NX + (int)(k - RF_AT_OUTPUT);
  if (k >= RF_AT_DERIVATIVE && k < RF_AT_DISCRETE) return (int)(k - RF_AT_DERIVATIVE);
  if (k >= RF_AT_EVENT) return RS_NX + RF_NY + (int)(k - RF_AT_EVENT);
  if (k >= RF_AT_STATE && k < RF_AT_DERIVATIVE && rf_beginning(i)) return RF_N_UNKNOWN + (int)(k - RF_AT_STATE);
  return -1;
}

/* The place of a known in seed, -1 for what is none; a parameter: the first of those that it sets. */
static int rf_column(unsigned k) {
  if (k == RF_AT_TIME) return RF_SEED_TIME;
  if (k >= RF_AT_PARAMETER && k < RF_AT_INPUT) return RF_SEED_P + rf_follow[rf_follow_at[k - RF_AT_PARAMETER]];
  if (k >= RF_AT_INPUT && k < RF_AT_OUTPUT) return RF_SEED_Z + RF_NZ + (int)(k - RF_AT_INPUT);
  if (k >= RF_AT_STATE && k < RF_AT_DERIVATIVE) return (int)(k - RF_AT_STATE);
  if (k >= RF_AT_DISCRETE && k < RF_AT_EVENT) return RF_SEED_Z + (int)(k - RF_AT_DISCRETE);
  return -1;
}

/* Where the seeds are parameters, so are the results: all positions of p that one parameter sets. */
static void rf_add_parameter(rf_instance *i, unsigned k, double value) {
  const unsigned a = k - RF_AT_PARAMETER;
  for (int j = rf_follow_at[a]; j < rf_follow_at[a + 1]; ++j) i->seed[RF_SEED_P + rf_follow[j]] += value;
}

static double rf_sum_parameter(const rf_instance *i, unsigned k) {
  const unsigned a = k - RF_AT_PARAMETER;
  double sum = 0.0;
  for (int j = rf_follow_at[a]; j < rf_follow_at[a + 1]; ++j) sum += i->seed[RF_SEED_P + rf_follow[j]];
  return sum;
}

/* result = J seed. parameters: whether any of their seeds is set. */
static void rf_forward(rf_instance *i, int parameters) {
  const double *p = rf_p(i);
  if (parameters && rf_beginning(i)) {
    rf_start_tangent(p, i->seed + RF_SEED_P, i->begun, i->work);
    for (int k = 0; k < RS_NX; ++k) i->seed[k] += rf_x_exact[k] ? 0.0 : i->begun[k];
    for (int k = 0; k < RF_NZ; ++k) i->seed[RF_SEED_Z + k] += rf_z_exact[k] ? 0.0 : i->begun[RS_NX + k];
  }
  rf_tangent(i->d[RF_TIME], rf_x(i), rf_z(i), p, i->extra, i->seed, i->result, i->work);
  memcpy(i->result + RF_N_UNKNOWN, i->seed, RS_NX * sizeof(double));
  if (!parameters) return;
  rf_tangent_p(i->d[RF_TIME], rf_x(i), rf_z(i), p, i->extra, i->seed + RF_SEED_P, i->more, i->work);
  for (int k = 0; k < RF_N_UNKNOWN; ++k) i->result[k] += i->more[k];
}

/* seed = J^T result. parameters: whether any of them is asked for. */
static void rf_backward(rf_instance *i, int parameters) {
  const double *p = rf_p(i);
  double *by_p = i->seed + RF_SEED_P;
  rf_adjoint(i->d[RF_TIME], rf_x(i), rf_z(i), p, i->extra, i->result, i->seed, i->work);
  for (int k = 0; k < RS_NX; ++k) i->seed[k] += i->result[RF_N_UNKNOWN + k];
  if (!parameters) return;
  rf_adjoint_p(i->d[RF_TIME], rf_x(i), rf_z(i), p, i->extra, i->result, by_p, i->work);
  if (!rf_beginning(i)) return;
  memset(i->begun, 0, sizeof i->begun);
  for (int k = 0; k < RS_NX; ++k) i->begun[k] = rf_x_exact[k] ? 0.0 : i->seed[k];
  for (int k = 0; k < RF_NZ; ++k) i->begun[RS_NX + k] = rf_z_exact[k] ? 0.0 : i->seed[RF_SEED_Z + k];
  rf_start_adjoint(p, i->begun, i->more, i->work);
  for (int k = 0; k < RF_NP; ++k) by_p[k] += i->more[k];
}

static int rf_no_place(rf_instance *i, const char *function, unsigned k, int known) {
  return rf_log(i, RF_ERROR, "%s: %s is no %s", function, rf_name[k],
                known ? "state, input, parameter or time" : "state derivative, output or event indicator");
}

/* Add the directional derivative: forward, seed by knowns and read unknowns; else (adjoint) the other way. */
static int rf_directional(rf_instance *i, const char *function, const unsigned *unknowns, size_t n_unknowns,
                          const unsigned *knowns, size_t n_knowns, const double *seed, long long n_seed, double *result,
                          long long n_result, int forward) {
  const unsigned *given = forward ? knowns : unknowns, *wanted = forward ? unknowns : knowns;
  const size_t n_given = forward ? n_knowns : n_unknowns, n_wanted = forward ? n_unknowns : n_knowns;
  double *from = forward ? i->seed : i->result, *to = forward ? i->result : i->seed;
  long long at = 0;
  int parameters = 0;
  if (rf_allow(i, function, RF_ANY & ~(RF_INSTANTIATED | RF_FAILED))) return RF_ERROR;
  memset(i->seed, 0, sizeof i->seed);
  memset(i->result, 0, sizeof i->result);
  for (size_t j = 0; j < n_knowns; ++j) parameters |= knowns[j] >= RF_AT_PARAMETER && knowns[j] < RF_AT_INPUT;
  for (size_t j = 0; j < n_given; ++j) {
    if (rf_known(i, function, given[j])) return RF_ERROR;
    for (unsigned k = given[j]; k < given[j] + rf_width[given[j]]; ++k) {
      const int place = forward ? rf_column(k) : rf_row(i, k);
      if (place < 0) return rf_no_place(i, function, given[j], forward);
      if (n_seed >= 0 && at >= n_seed) return rf_log(i, RF_ERROR, "%s: too few seeds", function);
      if (forward && place >= RF_SEED_P) rf_add_parameter(i, k, seed[at++]);
      else from[place] += seed[at++];
    }
  }
  rf_refresh_extra(i);
  if (forward) rf_forward(i, parameters);
  else rf_backward(i, parameters);
  at = 0;
  for (size_t j = 0; j < n_wanted; ++j) {
    if (rf_known(i, function, wanted[j])) return RF_ERROR;
    for (unsigned k = wanted[j]; k < wanted[j] + rf_width[wanted[j]]; ++k) {
      const int place = forward ? rf_row(i, k) : rf_column(k);
      if (place < 0) return rf_no_place(i, function, wanted[j], !forward);
      if (n_result >= 0 && at >= n_result) return rf_log(i, RF_ERROR, "%s: too few sensitivities", function);
      result[at++] = !forward && place >= RF_SEED_P ? rf_sum_parameter(i, k) : to[place];
    }
  }
  return RF_OK;
}

/* First derivatives of outputs by time, inputs held. */
static int rf_output_rates(rf_instance *i, const char *function, const unsigned *references, size_t n,
                           const int *orders, double *values, long long n_values) {
  long long at = 0;
  rf_rates(i);
  memset(i->seed, 0, sizeof i->seed);
  memcpy(i->seed, i->rate, RS_NX * sizeof(double));
  i->seed[RF_SEED_TIME] = 1.0;
  rf_refresh_extra(i);
  rf_tangent(i->d[RF_TIME], rf_x(i), rf_z(i), rf_p(i), i->extra, i->seed, i->result, i->work);
  for (size_t j = 0; j < n; ++j) {
    const unsigned k = references[j];
    if (rf_known(i, function, k)) return RF_ERROR;
    if (orders[j] != 1) return rf_log(i, RF_ERROR, "%s: order %d of %s; only 1 is known", function, orders[j], rf_name[k]);
    if (k < RF_AT_OUTPUT || k >= RF_AT_STATE) return rf_log(i, RF_ERROR, "%s: %s is no output", function, rf_name[k]);
    for (unsigned e = 0; e < rf_width[k]; ++e) {
      if (n_values >= 0 && at >= n_values) return rf_log(i, RF_ERROR, "%s: too few values", function);
      values[at++] = i->result[rf_row(i, k + e)];
    }
  }
  return RF_OK;
}
#endif

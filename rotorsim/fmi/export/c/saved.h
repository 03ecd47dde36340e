/* Saved states of an instance with those of the FMUs inside, where all of them can save theirs. It is a part of
 * stepping.h. */

/* made: number of each instance inside when it was saved; of another one its state may not be that of this FMU. */
typedef struct {
  double d[RF_TOTAL], p[RF_NESTED_P + 1], due[RF_NESTED], time[RF_NESTED], since[RF_NESTED], steps[RF_NESTED];
  rf_switching at;
  int ended, made[RF_NESTED], begun[RF_NESTED], fresh[RF_NESTED];
  void *inner[RF_NESTED];
} rf_saved;

/* Call Get, Set or Free on the state of an FMU inside; return whether it failed. */
static int rf_inner_state(rf_inner *n, const char *verb, void **state) {
  char name[24];
  snprintf(name, sizeof name, "%sFMU%s", verb, n->model->version == 2 ? "state" : "State");
  const rf_function function = rf_find(n, name);
  if (!function) return rf_failed(n, RF_ERROR, "its library has no function fmi%d%s", n->model->version, name);
  return rf_wrong(n, name, *verb == 'S' ? ((int (*)(void *, void *))function)(n->at.instance, *state)
                                        : ((int (*)(void *, void **))function)(n->at.instance, state));
}

static int rf_unsaved(rf_instance *i, const char *function) {
  return rf_log(i, RF_ERROR, "%s: not offered: this FMU holds other FMUs", function);
}

static void rf_free_saved(rf_instance *i, void *state) {
  rf_saved *saved = (rf_saved *)state;
  for (int k = 0; saved && k < RF_NESTED; ++k)
    if (saved->inner[k] && saved->made[k] == i->inner[k].made) rf_inner_state(i->inner + k, "Free", saved->inner + k);
  free(saved);
}

static int rf_save(rf_instance *i, void **state) {
  if (!RF_SAVES) return rf_unsaved(i, "GetFMUState");
  rf_refresh(i); /* begins those inside that are to begin anew */
  rf_saved *saved = (rf_saved *)(*state ? *state : calloc(1, sizeof *saved));
  if (!saved) return rf_log(i, RF_ERROR, "not enough memory for a state of %d bytes", (int)sizeof *saved);
  *state = saved;
  double *p = saved->p;
  memcpy(saved->d, i->d, sizeof i->d);
  saved->at = i->at;
  saved->ended = i->ended;
  for (int k = 0; k < RF_NESTED && i->status < RF_DISCARD; p += i->inner[k++].model->n_p) {
    rf_inner *n = i->inner + k;
    if (saved->made[k] != n->made) saved->inner[k] = 0;
    saved->made[k] = n->made, saved->begun[k] = n->begun, saved->fresh[k] = n->fresh, saved->due[k] = n->at.due;
    saved->time[k] = n->time, saved->since[k] = n->since, saved->steps[k] = n->steps;
    memcpy(p, n->p, (size_t)n->model->n_p * sizeof *p);
    rf_inner_state(n, "Get", saved->inner + k);
  }
  return rf_outcome(i);
}

static int rf_restore(rf_instance *i, const char *function, const void *state) {
  const rf_saved *saved = (const rf_saved *)state;
  if (!RF_SAVES) return rf_unsaved(i, function);
  if (!saved || saved->d[RF_MAGIC] != RF_MAGIC_NUMBER || saved->d[RF_KIND] != i->d[RF_KIND])
    return rf_log(i, RF_ERROR, "%s: this is not a state of this FMU", function);
  for (int k = 0; k < RF_NESTED; ++k)
    if (saved->made[k] != i->inner[k].made)
      return rf_log(i, RF_ERROR, "%s: %s has begun anew since the state was saved", function, i->inner[k].model->block);
  const double *p = saved->p;
  memcpy(i->d, saved->d, sizeof i->d);
  i->at = saved->at;
  i->ended = saved->ended;
  i->status = RF_OK;
  for (int k = 0; k < RF_NESTED && i->status < RF_DISCARD; p += i->inner[k++].model->n_p) {
    rf_inner *n = i->inner + k;
    void *inner = saved->inner[k];
    n->begun = saved->begun[k], n->fresh = saved->fresh[k], n->at.due = saved->due[k];
    n->time = saved->time[k], n->since = saved->since[k], n->steps = saved->steps[k];
    memcpy(n->p, p, (size_t)n->model->n_p * sizeof *p);
    rf_inner_state(n, "Set", &inner);
  }
  rf_soil(i, RF_STALE_EXTRA | RF_STALE_VALUES);
  return rf_outcome(i);
}

static size_t rf_serialised(const rf_instance *i) {
  (void)i;
  return 0;
}

static int rf_serialise(rf_instance *i, const char *function, const void *state, void *bytes, size_t size) {
  (void)state, (void)bytes, (void)size;
  return rf_unsaved(i, function);
}

static int rf_deserialise(rf_instance *i, const char *function, const void *bytes, size_t size, void **state) {
  (void)bytes, (void)size, (void)state;
  return rf_unsaved(i, function);
}

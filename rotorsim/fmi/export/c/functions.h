/* The functions that FMI 2 and FMI 3 offer in the same words. Before this, a version defines RF_FMI, the start of the
 * names of its functions; RF_BOOLEAN and RF_BYTE, its types; RF_STATE, how it spells the state of an FMU in names
 * (RF_DESERIALIZE: with the verb), RF_DERIVATIVES, its function for the derivatives of the states; and, for static
 * linking only, RF_PREFIX, which is <modelIdentifier>_.
 */
#define RF_JOIN(a, b) a##b
#define RF_PASTE(a, b) RF_JOIN(a, b)
#if defined(RF_PREFIX)
#define FMI(name) RF_PASTE(RF_PREFIX, RF_PASTE(RF_FMI, name))
#else
#define FMI(name) RF_PASTE(RF_FMI, name)
#endif
#if defined(_WIN32)
#define RF_EXPORT __declspec(dllexport)
#else
#define RF_EXPORT __attribute__((visibility("default")))
#endif

typedef void *rf_component;
typedef void *rf_state;
typedef int rf_status; /* OK, Warning, Discard, Error, Fatal: 0 to 4, as RF_OK ... */

#define INSTANCE                     \
  rf_instance *i = (rf_instance *)c; \
  if (!i) return RF_ERROR
#define ALLOW(phases) \
  INSTANCE;           \
  if (rf_allow(i, __func__, phases)) return RF_ERROR

RF_EXPORT rf_status FMI(SetDebugLogging)(rf_component c, RF_BOOLEAN on, size_t n, const char *const names[]) {
  INSTANCE;
  return rf_set_logging(i, on, n, names);
}

RF_EXPORT void FMI(FreeInstance)(rf_component c) { rf_destroy((rf_instance *)c); }

RF_EXPORT rf_status FMI(ExitInitializationMode)(rf_component c) {
  ALLOW(RF_INITIALISING);
  return rf_exit_initialisation(i);
}

RF_EXPORT rf_status FMI(Terminate)(rf_component c) {
  ALLOW(RF_EVENT | RF_CONTINUOUS | RF_STEPPING);
  i->d[RF_PHASE] = RF_TERMINATED;
#if RF_NESTED
  rf_terminate_inners(i);
#endif
  return rf_outcome(i);
}

RF_EXPORT rf_status FMI(Reset)(rf_component c) {
  INSTANCE;
  rf_begin(i, (int)i->d[RF_KIND]);
  return RF_OK;
}

/* ---- saved states ---- */

#define RF_STATE_FUNCTION(verb) FMI(RF_PASTE(verb, RF_STATE))

RF_EXPORT rf_status RF_STATE_FUNCTION(Get)(rf_component c, rf_state *state) {
  INSTANCE;
  return rf_save(i, state);
}

RF_EXPORT rf_status RF_STATE_FUNCTION(Set)(rf_component c, rf_state state) {
  INSTANCE;
  return rf_restore(i, __func__, state);
}

RF_EXPORT rf_status RF_STATE_FUNCTION(Free)(rf_component c, rf_state *state) {
  INSTANCE;
  if (state) rf_free_saved(i, *state), *state = 0;
  return RF_OK;
}

RF_EXPORT rf_status FMI(RF_PASTE(RF_PASTE(Serialized, RF_STATE), Size))(rf_component c, rf_state state, size_t *size) {
  INSTANCE;
  (void)state;
  *size = rf_serialised(i);
  return RF_OK;
}

RF_EXPORT rf_status RF_STATE_FUNCTION(Serialize)(rf_component c, rf_state state, RF_BYTE bytes[], size_t size) {
  INSTANCE;
  return rf_serialise(i, __func__, state, bytes, size);
}

RF_EXPORT rf_status FMI(RF_DESERIALIZE)(rf_component c, const RF_BYTE bytes[], size_t size, rf_state *state) {
  INSTANCE;
  return rf_deserialise(i, __func__, bytes, size, state);
}

/* ---- model exchange ---- */

RF_EXPORT rf_status FMI(EnterEventMode)(rf_component c) {
  ALLOW(RF_EVENT | RF_CONTINUOUS);
  i->d[RF_PHASE] = RF_EVENT;
  return RF_OK;
}

RF_EXPORT rf_status FMI(EnterContinuousTimeMode)(rf_component c) {
  ALLOW(RF_EVENT);
  i->d[RF_PHASE] = RF_CONTINUOUS;
  return RF_OK;
}

RF_EXPORT rf_status FMI(CompletedIntegratorStep)(rf_component c, RF_BOOLEAN no_set_state, RF_BOOLEAN *enter_event_mode,
                                                 RF_BOOLEAN *terminate) {
  ALLOW(RF_CONTINUOUS);
  *enter_event_mode = *terminate = 0;
#if RF_NESTED
  *enter_event_mode = rf_completed(i, no_set_state) != 0;
  *terminate = i->ended != 0;
#else
  (void)no_set_state;
#endif
  return rf_outcome(i);
}

RF_EXPORT rf_status FMI(SetTime)(rf_component c, double time) {
  ALLOW(RF_EVENT | RF_CONTINUOUS);
  rf_set_time(i, time);
  return RF_OK;
}

RF_EXPORT rf_status FMI(SetContinuousStates)(rf_component c, const double x[], size_t n) {
  ALLOW(RF_EVENT | RF_CONTINUOUS);
  return rf_set_states(i, x, n);
}

RF_EXPORT rf_status FMI(RF_DERIVATIVES)(rf_component c, double rate[], size_t n) {
  ALLOW(RF_INITIALISING | RF_EVENT | RF_CONTINUOUS | RF_TERMINATED);
  return rf_get_rates(i, rate, n);
}

RF_EXPORT rf_status FMI(GetEventIndicators)(rf_component c, double event[], size_t n) {
  ALLOW(RF_INITIALISING | RF_EVENT | RF_CONTINUOUS | RF_TERMINATED);
  return rf_get_indicators(i, event, n);
}

RF_EXPORT rf_status FMI(GetContinuousStates)(rf_component c, double x[], size_t n) {
  INSTANCE;
  return rf_get_states(i, x, n);
}

RF_EXPORT rf_status FMI(GetNominalsOfContinuousStates)(rf_component c, double nominal[], size_t n) {
  INSTANCE;
  return rf_get_nominals(i, nominal, n);
}

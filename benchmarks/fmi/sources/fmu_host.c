/* The smallest host of an FMU 2.0 for Co-Simulation: runs its library and prints outputs, with all digits.
 *
 *   fmu_host LIBRARY GUID STEP COUNT EVERY REFERENCE ...
 *
 * steps COUNT times by STEP [s]; at every EVERY-th a line with the Real variables of these value references.
 * The same source for Windows (also run by wine) and POSIX, so that the libraries of two platforms can be compared.
 */
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#endif

enum { CO_SIMULATION = 1, MOST = 64 };

typedef struct { /* fmi2CallbackFunctions, FMI 2.0.4 section 2.1.5 */
    void (*log)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished;
    void *environment;
} callbacks;

static void say(void *environment, const char *instance, int status, const char *category, const char *message, ...)
{
    (void)environment, (void)category;
    fprintf(stderr, "%s: status %d: %s\n", instance, status, message);
}

static int stop(const char *what)
{
    fprintf(stderr, "%s failed\n", what);
    return 1;
}

int main(int argc, char **argv)
{
    if (argc < 7 || argc > 6 + MOST)
        return stop("usage");
    void *library = OPEN(argv[1]);
    if (!library)
        return stop("opening the library");
    void *(*instantiate)(const char *, int, const char *, const char *, const callbacks *, int, int) =
        FIND(library, "fmi2Instantiate");
    int (*setup)(void *, int, double, double, int, double) = FIND(library, "fmi2SetupExperiment");
    int (*enter)(void *) = FIND(library, "fmi2EnterInitializationMode");
    int (*leave)(void *) = FIND(library, "fmi2ExitInitializationMode");
    int (*step)(void *, double, double, int) = FIND(library, "fmi2DoStep");
    int (*get)(void *, const unsigned *, size_t, double *) = FIND(library, "fmi2GetReal");
    void (*release)(void *) = FIND(library, "fmi2FreeInstance");
    if (!instantiate || !setup || !enter || !leave || !step || !get || !release)
        return stop("finding the functions of FMI 2.0");

    const callbacks functions = {say, calloc, free, NULL, NULL};
    const double h = atof(argv[3]);
    const long count = atol(argv[4]), every = atol(argv[5]);
    const int n = argc - 6;
    unsigned references[MOST];
    double values[MOST];
    for (int k = 0; k < n; k++)
        references[k] = (unsigned)atol(argv[6 + k]);
    void *fmu = instantiate("fmu", CO_SIMULATION, argv[2], "", &functions, 0, 0);
    if (!fmu)
        return stop("fmi2Instantiate");
    if (setup(fmu, 0, 0.0, 0.0, 0, 0.0) || enter(fmu) || leave(fmu))
        return stop("initialisation");
    for (long k = 1; k <= count; k++) {
        if (step(fmu, (double)(k - 1) * h, h, 1))
            return stop("fmi2DoStep");
        if (k % every)
            continue;
        if (get(fmu, references, (size_t)n, values))
            return stop("fmi2GetReal");
        for (int j = 0; j < n; j++)
            printf(j ? " %.17g" : "%.17g", values[j]);
        printf("\n");
    }
    release(fmu);
    return 0;
}

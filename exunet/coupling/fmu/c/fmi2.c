/* FMI 2.0 for co-simulation, as its standard describes the functions; the declarations are our own. */
#include "instance.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))

typedef void logger2(void *environment, const char *name, int status, const char *category, const char *message, ...);

typedef struct {
    logger2 *logger;
    void *(*allocate)(size_t number, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} callbacks;

/* The message is a format of printf in FMI 2, so per cent signs are doubled. */
static void tell(instance *it, enum status status, const char *text)
{
    char *format = malloc(2 * strlen(text) + 1), *to = format;

    if (format == NULL || it->logger == NULL) {
        free(format);
        return;
    }
    for (; *text != '\0'; text++) {
        if (*text == '%')
            *to++ = '%';
        *to++ = *text;
    }
    *to = '\0';
    ((logger2 *)it->logger)(it->environment, it->name, status,
                            status == DISCARD ? "logStatusDiscard" : "logStatusError", format);
    free(format);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT int fmi2SetDebugLogging(instance *it, int on, size_t number, const char *const categories[])
{
    (void)on, (void)number, (void)categories; /* only errors are told */
    return it == NULL ? ERROR : OK;
}

EXPORT instance *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                                 const callbacks *host, int visible, int logging)
{
    (void)visible, (void)logging;
    if (host == NULL || type != 1) /* co-simulation */
        return NULL;
    return instance_new(name, token, resources, tell, host->environment, (void (*)(void))host->logger);
}

EXPORT void fmi2FreeInstance(instance *it) { instance_free(it); }

EXPORT int fmi2SetupExperiment(instance *it, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop; /* the case says how accurate it is */
    return check_start(it, start);
}

EXPORT int fmi2EnterInitializationMode(instance *it) { return enter_initialisation(it); }
EXPORT int fmi2ExitInitializationMode(instance *it) { return exit_initialisation(it); }
EXPORT int fmi2Terminate(instance *it) { return terminate(it); }
EXPORT int fmi2Reset(instance *it) { return reset(it); }

EXPORT int fmi2GetReal(instance *it, const unsigned reference[], size_t number, double value[])
{
    return get(it, reference, number, NUMBER, value);
}

EXPORT int fmi2SetReal(instance *it, const unsigned reference[], size_t number, const double value[])
{
    return set(it, reference, number, NUMBER, value);
}

EXPORT int fmi2GetBoolean(instance *it, const unsigned reference[], size_t number, int value[])
{
    size_t k;
    double one;

    for (k = 0; k < number; k++) {
        if (get(it, reference + k, 1, SWITCH, &one) != OK)
            return ERROR;
        value[k] = one != 0.0;
    }
    return OK;
}

EXPORT int fmi2SetBoolean(instance *it, const unsigned reference[], size_t number, const int value[])
{
    size_t k;

    for (k = 0; k < number; k++) {
        const double one = value[k] != 0;
        if (set(it, reference + k, 1, SWITCH, &one) != OK)
            return ERROR;
    }
    return OK;
}

/* There are no variables of these types: none is what a host may ask for. */
#define NO_VARIABLES(name, type)                                                               \
    EXPORT int name(instance *it, const unsigned reference[], size_t number, type value[])     \
    {                                                                                          \
        (void)reference, (void)value;                                                          \
        return number == 0 && it != NULL ? OK : (int)refuse(it, #name);                        \
    }
NO_VARIABLES(fmi2GetInteger, int)
NO_VARIABLES(fmi2SetInteger, const int)
NO_VARIABLES(fmi2GetString, const char *)
NO_VARIABLES(fmi2SetString, const char *const)

EXPORT int fmi2GetFMUstate(instance *it, void **place) { return keep(it, place); }
EXPORT int fmi2SetFMUstate(instance *it, void *kept) { return restore(it, kept); }
EXPORT int fmi2FreeFMUstate(instance *it, void **place) { return forget(it, place); }
EXPORT int fmi2SerializedFMUstateSize(instance *it, void *kept, size_t *size) { return packed_size(it, kept, size); }

EXPORT int fmi2SerializeFMUstate(instance *it, void *kept, char bytes[], size_t size)
{
    return pack(it, kept, bytes, size);
}

EXPORT int fmi2DeSerializeFMUstate(instance *it, const char bytes[], size_t size, void **place)
{
    return unpack(it, bytes, size, place);
}

EXPORT int fmi2GetDirectionalDerivative(instance *it, const unsigned unknown[], size_t unknowns, const unsigned known[],
                                        size_t knowns, const double seed[], double sensitivity[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)sensitivity;
    return refuse(it, "fmi2GetDirectionalDerivative");
}

EXPORT int fmi2SetRealInputDerivatives(instance *it, const unsigned reference[], size_t number, const int order[],
                                       const double value[])
{
    (void)reference, (void)number, (void)order, (void)value;
    return refuse(it, "fmi2SetRealInputDerivatives");
}

EXPORT int fmi2GetRealOutputDerivatives(instance *it, const unsigned reference[], size_t number, const int order[],
                                        double value[])
{
    (void)reference, (void)number, (void)order, (void)value;
    return refuse(it, "fmi2GetRealOutputDerivatives");
}

EXPORT int fmi2DoStep(instance *it, double begin, double length, int keeps_no_state)
{
    (void)keeps_no_state;
    return step(it, begin, length);
}

EXPORT int fmi2CancelStep(instance *it) { return refuse(it, "fmi2CancelStep"); }

/* Steps end before doStep returns, so nothing is pending; a discarded one leaves the time where it was. */
EXPORT int fmi2GetStatus(instance *it, int kind, int *value)
{
    (void)kind;
    if (it != NULL && value != NULL)
        *value = OK;
    return it == NULL ? ERROR : OK;
}

EXPORT int fmi2GetRealStatus(instance *it, int kind, double *value)
{
    if (it == NULL || value == NULL || kind != 2) /* the last successful time */
        return DISCARD;
    *value = it->time;
    return OK;
}

EXPORT int fmi2GetIntegerStatus(instance *it, int kind, int *value)
{
    (void)it, (void)kind, (void)value;
    return DISCARD;
}

EXPORT int fmi2GetBooleanStatus(instance *it, int kind, int *value)
{
    if (it == NULL || value == NULL || kind != 3) /* whether the FMU ends the simulation */
        return DISCARD;
    *value = 0;
    return OK;
}

EXPORT int fmi2GetStringStatus(instance *it, int kind, const char **value)
{
    (void)it, (void)kind, (void)value;
    return DISCARD;
}

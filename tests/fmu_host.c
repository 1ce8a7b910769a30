/* A host for tests that loads an FMU as a simulator in C would: no Python in its process.
 *
 *     host 2|3 BINARY RESOURCES TOKEN
 *
 * It takes commands from standard input, one on a line, and answers each with the status that the FMU returned and,
 * where there is one, a value. What the FMU tells by its logger is a line that begins with "# ". Numbers are in
 * hexadecimal, so that none loses a bit.
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define INSTANCES 4
#define STATES 4

typedef void *fmu;
typedef const unsigned *references;

static int version;
static void *library;
static fmu instances[INSTANCES];
static void *states[STATES];

static void *function(const char *name)
{
    char full[100];
    void *found;

    snprintf(full, sizeof full, "fmi%d%s", version, name);
    found = dlsym(library, full);
    if (found == NULL) {
        printf("no function %s\n", full);
        exit(1);
    }
    return found;
}

static void tell(const char *format, va_list values)
{
    char text[5000], *end;

    vsnprintf(text, sizeof text, format, values);
    for (end = text; (end = strchr(end, '\n')) != NULL;)
        *end = ' ';
    printf("# %s\n", text);
}

static void logger2(void *environment, const char *name, int status, const char *category, const char *format, ...)
{
    va_list values;

    (void)environment, (void)name, (void)status, (void)category;
    va_start(values, format);
    tell(format, values);
    va_end(values);
}

static void told(const char *format, ...)
{
    va_list values;

    va_start(values, format);
    tell(format, values);
    va_end(values);
}

static void logger3(void *environment, int status, const char *category, const char *text)
{
    (void)environment, (void)status, (void)category;
    told("%s", text);
}

static struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} callbacks = {logger2, calloc, free, NULL, NULL};

static fmu instantiate(const char *token, const char *resources)
{
    if (version == 2) {
        fmu (*make)(const char *, int, const char *, const char *, const void *, int, int) = function("Instantiate");
        char uri[4200];
        snprintf(uri, sizeof uri, "file://%s", resources);
        return make("net", 1, token, uri, &callbacks, 0, 0);
    } else {
        fmu (*make)(const char *, const char *, const char *, bool, bool, bool, bool, references, size_t, void *,
                    void (*)(void *, int, const char *, const char *), void *) = function("InstantiateCoSimulation");
        return make("net", token, resources, false, false, false, false, NULL, 0, NULL, logger3, NULL);
    }
}

static int begin_initialisation(fmu it, double start, int has_stop, double stop)
{
    if (version == 2) {
        int (*setup)(fmu, int, double, double, int, double) = function("SetupExperiment");
        int (*enter)(fmu) = function("EnterInitializationMode");
        int status = setup(it, 0, 0.0, start, has_stop, stop);
        return status ? status : enter(it);
    } else {
        int (*enter)(fmu, bool, double, double, bool, double) = function("EnterInitializationMode");
        return enter(it, false, 0.0, start, has_stop, stop);
    }
}

static int plain(fmu it, const char *name)
{
    int (*call)(fmu) = function(name);
    return call(it);
}

static int step(fmu it, double begin, double length, double *last)
{
    if (version == 2) {
        int (*go)(fmu, double, double, int) = function("DoStep");
        int (*status_of)(fmu, int, double *) = function("GetRealStatus");
        int status = go(it, begin, length, 0);
        status_of(it, 2, last);
        return status;
    } else {
        int (*go)(fmu, double, double, bool, bool *, bool *, bool *, double *) = function("DoStep");
        bool event, ends, early;
        return go(it, begin, length, false, &event, &ends, &early, last);
    }
}

/* Of model exchange; FMUs of FMI 2.0 that have none need not have the function. */
static int set_time(fmu it, double time)
{
    int (*call)(fmu, double) = function("SetTime");
    return call(it, time);
}

static int set(fmu it, unsigned reference, double value)
{
    if (version == 2) {
        int (*call)(fmu, references, size_t, const double *) = function("SetReal");
        return call(it, &reference, 1, &value);
    } else {
        int (*call)(fmu, references, size_t, const double *, size_t) = function("SetFloat64");
        return call(it, &reference, 1, &value, 1);
    }
}

static int get(fmu it, unsigned reference, double *value)
{
    if (version == 2) {
        int (*call)(fmu, references, size_t, double *) = function("GetReal");
        return call(it, &reference, 1, value);
    } else {
        int (*call)(fmu, references, size_t, double *, size_t) = function("GetFloat64");
        return call(it, &reference, 1, value, 1);
    }
}

/* One variable, and so many values: FMI 3 tells both. */
static int turn(fmu it, unsigned reference, int on, size_t values)
{
    if (version == 2) {
        int (*call)(fmu, references, size_t, const int *) = function("SetBoolean");
        return call(it, &reference, 1, &on);
    } else {
        int (*call)(fmu, references, size_t, const bool *, size_t) = function("SetBoolean");
        bool value = on;
        return call(it, &reference, 1, &value, values);
    }
}

static const char *of_state(const char *verb)
{
    static char name[40];
    snprintf(name, sizeof name, "%s%s", verb, version == 2 ? "FMUstate" : "FMUState");
    return name;
}

static int keep(fmu it, void **place)
{
    int (*call)(fmu, void **) = function(of_state("Get"));
    return call(it, place);
}

static int back(fmu it, void *kept)
{
    int (*call)(fmu, void *) = function(of_state("Set"));
    return call(it, kept);
}

static int drop(fmu it, void **place)
{
    int (*call)(fmu, void **) = function(of_state("Free"));
    return call(it, place);
}

static int save(fmu it, void *kept, const char *path)
{
    int (*size_of)(fmu, void *, size_t *) = function(version == 2 ? "SerializedFMUstateSize" : "SerializedFMUStateSize");
    int (*pack)(fmu, void *, char *, size_t) = function(of_state("Serialize"));
    size_t size = 0;
    char *bytes;
    FILE *file;
    int status = size_of(it, kept, &size);

    if (status != 0)
        return status;
    bytes = malloc(size);
    status = pack(it, kept, bytes, size);
    file = fopen(path, "wb");
    fwrite(bytes, 1, size, file);
    fclose(file);
    free(bytes);
    return status;
}

static int load(fmu it, void **place, const char *path)
{
    int (*unpack)(fmu, const char *, size_t, void **) = function(of_state(version == 2 ? "DeSerialize" : "Deserialize"));
    FILE *file = fopen(path, "rb");
    size_t size;
    char *bytes;
    int status;

    fseek(file, 0, SEEK_END);
    size = (size_t)ftell(file);
    rewind(file);
    bytes = malloc(size);
    if (fread(bytes, 1, size, file) != size)
        exit(1);
    fclose(file);
    status = unpack(it, bytes, size, place);
    free(bytes);
    return status;
}

/* Keep, step, go back, forget: so many times from one instant. */
static int rollbacks(fmu it, int number, double begin, double length)
{
    double last;
    void *kept = NULL;
    int status = 0, k;

    for (k = 0; k < number && status == 0; k++) {
        status = keep(it, &kept);
        if (status == 0)
            status = step(it, begin, length, &last);
        if (status == 0)
            status = back(it, kept);
        if (status == 0)
            status = drop(it, &kept);
    }
    return status;
}

int main(int number, char **given)
{
    char line[5000], verb[20], path[4100];
    int i, s, on, many, count;
    unsigned reference;
    double a, b;

    if (number != 5)
        return 1;
    setvbuf(stdout, NULL, _IOLBF, 0);
    version = atoi(given[1]);
    library = dlopen(given[2], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) {
        printf("%s\n", dlerror());
        return 1;
    }
    while (fgets(line, sizeof line, stdin) != NULL) {
        if (sscanf(line, "%19s %d", verb, &i) != 2 || i < 0 || i >= INSTANCES)
            return 1;
        if (strcmp(verb, "new") == 0) {
            instances[i] = instantiate(given[4], given[3]);
            printf("%d\n", instances[i] == NULL ? 3 : 0);
        } else if (strcmp(verb, "free") == 0) {
            void (*call)(fmu) = function("FreeInstance");
            call(instances[i]);
            printf("0\n");
        } else if ((count = sscanf(line, "enter %d %lf %lf", &i, &a, &b)) >= 2)
            printf("%d\n", begin_initialisation(instances[i], a, count == 3, count == 3 ? b : 0.0));
        else if (strcmp(verb, "exit") == 0)
            printf("%d\n", plain(instances[i], "ExitInitializationMode"));
        else if (strcmp(verb, "terminate") == 0)
            printf("%d\n", plain(instances[i], "Terminate"));
        else if (strcmp(verb, "reset") == 0)
            printf("%d\n", plain(instances[i], "Reset"));
        else if (sscanf(line, "step %d %lf %lf", &i, &a, &b) == 3) {
            double last = -1.0;
            int status = step(instances[i], a, b, &last);
            printf("%d %a\n", status, last);
        } else if (sscanf(line, "time %d %lf", &i, &a) == 2)
            printf("%d\n", set_time(instances[i], a));
        else if (sscanf(line, "set %d %u %lf", &i, &reference, &a) == 3)
            printf("%d\n", set(instances[i], reference, a));
        else if (sscanf(line, "turn %d %u %d", &i, &reference, &on) == 3)
            printf("%d\n", turn(instances[i], reference, on, 1));
        else if (sscanf(line, "miscount %d %u %d", &i, &reference, &many) == 3)
            printf("%d\n", turn(instances[i], reference, 1, many));
        else if (sscanf(line, "get %d %u", &i, &reference) == 2) {
            int status = get(instances[i], reference, &a);
            printf("%d %a\n", status, a);
        } else if (sscanf(line, "keep %d %d", &i, &s) == 2)
            printf("%d\n", keep(instances[i], &states[s]));
        else if (sscanf(line, "back %d %d", &i, &s) == 2)
            printf("%d\n", back(instances[i], states[s]));
        else if (sscanf(line, "drop %d %d", &i, &s) == 2)
            printf("%d\n", drop(instances[i], &states[s]));
        else if (sscanf(line, "save %d %d %4099[^\n]", &i, &s, path) == 3)
            printf("%d\n", save(instances[i], states[s], path));
        else if (sscanf(line, "load %d %d %4099[^\n]", &i, &s, path) == 3)
            printf("%d\n", load(instances[i], &states[s], path));
        else if (sscanf(line, "rollbacks %d %d %lf %lf", &i, &many, &a, &b) == 4)
            printf("%d\n", rollbacks(instances[i], many, a, b));
        else
            return 1;
    }
    return 0;
}

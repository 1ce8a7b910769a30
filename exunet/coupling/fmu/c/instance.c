#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Part of the stop time by which hosts that add up their steps may pass it. */
#define ROUND_OFF 1e-9

/* Tell the host, and stop the instance. */
enum status fail(instance *it, const char *format, ...)
{
    char text[4096];
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    it->stopped = 1;
    it->tell(it, ERROR, text);
    return ERROR;
}

static enum status failed(instance *it, enum answer answer)
{
    it->stopped = 1;
    it->tell(it, ERROR, worker_words(&it->worker, answer));
    return ERROR;
}

enum status refuse(instance *it, const char *function)
{
    return it == NULL ? ERROR : fail(it, "%s: this FMU has no such function", function);
}

static int is_stopped(instance *it)
{
    if (it != NULL && it->stopped)
        it->tell(it, ERROR, "the instance was stopped by an earlier error: restore an FMU state, or reset it");
    return it == NULL || it->stopped;
}

static void start_values(instance *it)
{
    int k;

    for (k = 0; k < VARIABLES; k++)
        it->values[k] = table[k].start;
    it->mode = INSTANTIATED;
    it->stopped = it->built = 0;
    it->time = 0.0;
    it->stop = INFINITY;
}

static enum answer start_worker(instance *it)
{
    it->workers++;
    return worker_start(&it->worker, it->resources, TOKEN);
}

static int hexadecimal(char digit)
{
    if (digit >= '0' && digit <= '9')
        return digit - '0';
    if (digit >= 'a' && digit <= 'f')
        return digit - 'a' + 10;
    return digit >= 'A' && digit <= 'F' ? digit - 'A' + 10 : -1;
}

/* The path that a host gives, as it is or as a file URI; a new string, without a slash at its end. */
static char *path_of(const char *given)
{
    size_t length;
    char *path, *to;
    int is_uri = strncmp(given, "file:", 5) == 0;

    if (is_uri) {
        given += 5;
        if (strncmp(given, "//", 2) == 0) {
            given += 2;
            given += strcspn(given, "/"); /* the name of the machine, which is this one */
        }
    }
    path = to = malloc(strlen(given) + 1);
    if (path == NULL)
        return NULL;
    while (*given != '\0') {
        int high = is_uri && given[0] == '%' ? hexadecimal(given[1]) : -1;
        int low = high >= 0 ? hexadecimal(given[2]) : -1;
        if (low >= 0) {
            *to++ = (char)(16 * high + low);
            given += 3;
        } else
            *to++ = *given++;
    }
    *to = '\0';
    length = (size_t)(to - path);
    while (length > 1 && path[length - 1] == '/')
        path[--length] = '\0';
    return path;
}

static uint64_t instances; /* that there have been in this process */

instance *instance_new(const char *name, const char *token, const char *resources, teller *tell, void *environment,
                       void (*logger)(void))
{
    instance *it = calloc(1, sizeof *it);
    enum answer answer;

    if (it == NULL)
        return NULL;
    it->identity = __atomic_add_fetch(&instances, 1, __ATOMIC_RELAXED);
    it->worker.socket = -1;
    it->tell = tell;
    it->environment = environment;
    it->logger = logger;
    it->name = strdup(name == NULL ? "" : name);
    it->resources = path_of(resources == NULL ? "" : resources);
    start_values(it);
    if (it->name == NULL || it->resources == NULL)
        fail(it, "no memory for the instance");
    else if (token == NULL || strcmp(token, TOKEN) != 0)
        fail(it, "the token of the model description is not that of this binary: they are of two exports");
    else if (it->resources[0] == '\0')
        fail(it, "the host gives no path of the FMU's resources, where its case is");
    else if ((answer = start_worker(it)) != DONE)
        failed(it, answer);
    if (it->stopped) {
        instance_free(it);
        return NULL;
    }
    return it;
}

void instance_free(instance *it)
{
    if (it == NULL)
        return;
    worker_end(&it->worker);
    free(it->name);
    free(it->resources);
    free(it);
}

/* Take over values that the worker has replied; returns 0 if they are not so many. */
static int take_values(instance *it)
{
    if (it->worker.size != sizeof it->values)
        return 0;
    memcpy(it->values, it->worker.reply, sizeof it->values);
    return 1;
}

/* Let the worker make a net for the values as they are, if it has none. */
static enum status build(instance *it)
{
    const part parts[] = {{it->values, sizeof it->values}};
    enum answer answer;

    if (it->built)
        return OK;
    answer = worker_ask(&it->worker, BUILD, parts, 1);
    if (answer != DONE)
        return failed(it, answer);
    if (!take_values(it))
        return fail(it, "the worker's reply has not the values of all variables");
    it->built = 1;
    return OK;
}

/* The number of a variable in the table, or -1, after the host was told. */
static int find(instance *it, unsigned reference, enum kind kind)
{
    if (reference < 1 || reference > VARIABLES) {
        fail(it, "there is no variable with the value reference %u", reference);
        return -1;
    }
    if ((enum kind)table[reference - 1].kind != kind) {
        fail(it, "%s is %s", table[reference - 1].name,
             kind == NUMBER ? "a boolean, and no number" : "a number, and no boolean");
        return -1;
    }
    return (int)reference - 1;
}

enum status get(instance *it, const unsigned *reference, size_t number, enum kind kind, double *values)
{
    size_t k;

    if (is_stopped(it))
        return ERROR;
    for (k = 0; k < number; k++) {
        int at;
        if (reference[k] == 0 && kind == NUMBER) {
            values[k] = it->time;
            continue;
        }
        at = find(it, reference[k], kind);
        if (at < 0)
            return ERROR;
        if (table[at].causality == 'o' && it->mode == INITIALISING && build(it) != OK)
            return ERROR;
        values[k] = it->values[at];
    }
    return OK;
}

enum status set(instance *it, const unsigned *reference, size_t number, enum kind kind, const double *values)
{
    size_t k;

    if (is_stopped(it))
        return ERROR;
    for (k = 0; k < number; k++) {
        int at = find(it, reference[k], kind);
        if (at < 0)
            return ERROR;
        if (table[at].causality == 'o')
            return fail(it, "%s is an output, which cannot be set", table[at].name);
        if (table[at].causality == 'p' && it->mode >= STEPPING)
            return fail(it, "%s is a parameter, which cannot be set after the initialisation", table[at].name);
        if (!isfinite(values[k]))
            return fail(it, "%s cannot be set to %g", table[at].name, values[k]);
        if (it->mode < STEPPING && it->values[at] != values[k])
            it->built = 0;
        it->values[at] = values[k];
    }
    return OK;
}

enum status set_times(instance *it, double start, int has_stop, double stop)
{
    if (is_stopped(it))
        return ERROR;
    if (start != 0.0)
        return fail(it, "the start time must be 0, got %g s: the case's own times begin there", start);
    if (has_stop && !(stop >= start))
        return fail(it, "the stop time must not be before the start time 0, got %g s", stop);
    it->stop = has_stop ? stop : INFINITY;
    return OK;
}

enum status enter_initialisation(instance *it)
{
    if (is_stopped(it))
        return ERROR;
    if (it->mode != INSTANTIATED)
        return fail(it, "the initialisation mode can be entered once, after the instantiation or a reset");
    it->mode = INITIALISING;
    return OK;
}

enum status exit_initialisation(instance *it)
{
    if (is_stopped(it))
        return ERROR;
    if (it->mode != INITIALISING)
        return fail(it, "the initialisation mode cannot be left: it was not entered");
    if (build(it) != OK)
        return ERROR;
    it->mode = STEPPING;
    return OK;
}

enum status step(instance *it, double begin, double length)
{
    const double times[2] = {begin, begin + length};
    const part parts[] = {{times, sizeof times}, {it == NULL ? NULL : it->values, sizeof it->values}};
    enum answer answer;

    if (is_stopped(it))
        return ERROR;
    if (it->mode != STEPPING)
        return fail(it, "doStep: the FMU is not initialised, or was terminated");
    if (!isfinite(times[0]) || !isfinite(times[1]))
        return fail(it, "doStep: from %g s by %g s are no finite times", begin, length);
    if (length < 0.0)
        return fail(it, "doStep: a communication step of %g s goes back in time: restore an FMU state that was kept, "
                        "or reset the FMU, which begins at 0 s again", length);
    if (!(length > 0.0))
        return fail(it, "doStep: the communication step must be positive, got %g s", length);
    if (!(times[1] > times[0]))
        return fail(it, "doStep: a communication step of %g s is lost in the round-off of the time, %.9g s", length,
                    begin);
    if (times[1] > it->stop * (1.0 + ROUND_OFF))
        return fail(it, "doStep: a step to %.9g s passes the stop time %.9g s that the host gave: end the last step "
                        "there, or reset the FMU and give a later one", times[1], it->stop);
    answer = worker_ask(&it->worker, STEP, parts, 2);
    if (answer == STOPPED) {
        it->tell(it, DISCARD, it->worker.reply);
        return DISCARD;
    }
    if (answer != DONE)
        return failed(it, answer);
    if (!take_values(it))
        return fail(it, "the worker's reply has not the values of all variables");
    it->time = times[1];
    return OK;
}

enum status terminate(instance *it)
{
    if (is_stopped(it))
        return ERROR;
    if (it->mode != STEPPING)
        return fail(it, "the FMU is not initialised, or was terminated: there is nothing to terminate");
    it->mode = TERMINATED;
    return OK;
}

enum status reset(instance *it)
{
    if (it == NULL)
        return ERROR;
    start_values(it);
    if (it->worker.socket < 0) {
        enum answer answer = start_worker(it);
        if (answer != DONE)
            return failed(it, answer);
    }
    return OK;
}

/* Whether a state cannot be had any more, after the host was told. */
static int is_lost(instance *it, const state *kept)
{
    if (kept->identity != it->identity)
        fail(it, "the FMU state is of another instance: serialise it there, and deserialise it here");
    else if (kept->worker != it->workers)
        fail(it, "the FMU state was lost with the worker that had it");
    return kept->identity != it->identity || kept->worker != it->workers;
}

/* The worker forgets its part of a state. */
static void free_number(instance *it, const state *kept)
{
    const part parts[] = {{&kept->number, sizeof kept->number}};

    if (kept->identity == it->identity && kept->worker == it->workers)
        worker_ask(&it->worker, FREE, parts, 1); /* of one that is gone there is nothing to forget */
}

enum status forget(instance *it, void **place)
{
    state *kept = place == NULL ? NULL : *place;

    if (it == NULL)
        return ERROR;
    if (kept != NULL) {
        free_number(it, kept);
        free(kept->bytes);
        free(kept);
        *place = NULL;
    }
    return OK;
}

/* A new state with the host's side of the instance as it is now. */
static state *new_state(instance *it)
{
    state *kept = calloc(1, sizeof *kept);

    if (kept == NULL) {
        fail(it, "no memory for an FMU state");
        return NULL;
    }
    kept->identity = it->identity;
    kept->worker = it->workers;
    kept->side[0] = it->mode;
    kept->side[1] = it->built;
    kept->side[2] = it->time;
    kept->side[3] = it->stop;
    memcpy(kept->side + 4, it->values, sizeof it->values);
    return kept;
}

static enum status take_number(instance *it, state *kept)
{
    if (it->worker.size < sizeof kept->number)
        return fail(it, "the worker's reply has no number of a state");
    memcpy(&kept->number, it->worker.reply, sizeof kept->number);
    return OK;
}

enum status keep(instance *it, void **place)
{
    state *kept;
    enum answer answer;

    if (is_stopped(it))
        return ERROR;
    if (place == NULL)
        return fail(it, "the host gives no place for the FMU state");
    kept = new_state(it);
    if (kept == NULL)
        return ERROR;
    answer = worker_ask(&it->worker, KEEP, NULL, 0);
    if (answer != DONE || take_number(it, kept) != OK) {
        free(kept);
        return answer != DONE ? failed(it, answer) : ERROR;
    }
    if (*place != NULL) /* the host gives up the state that it had there */
        forget(it, place);
    *place = kept;
    return OK;
}

enum status restore(instance *it, void *given)
{
    const state *kept = given;
    part parts[1];
    enum answer answer;

    if (it == NULL)
        return ERROR;
    if (kept == NULL)
        return fail(it, "there is no FMU state to restore");
    if (is_lost(it, kept))
        return ERROR;
    parts[0].data = &kept->number;
    parts[0].size = sizeof kept->number;
    answer = worker_ask(&it->worker, RESTORE, parts, 1);
    if (answer != DONE)
        return failed(it, answer);
    it->mode = (enum mode)kept->side[0];
    it->built = (int)kept->side[1];
    it->time = kept->side[2];
    it->stop = kept->side[3];
    memcpy(it->values, kept->side + 4, sizeof it->values);
    it->stopped = 0;
    return OK;
}

static enum status packed(instance *it, state *kept)
{
    const part parts[] = {{kept == NULL ? NULL : &kept->number, sizeof(uint64_t)},
                          {kept == NULL ? NULL : kept->side, sizeof kept->side}};
    enum answer answer;

    if (is_stopped(it))
        return ERROR;
    if (kept == NULL)
        return fail(it, "there is no FMU state to serialise");
    if (kept->bytes != NULL)
        return OK;
    if (is_lost(it, kept))
        return ERROR;
    answer = worker_ask(&it->worker, PACK, parts, 2);
    if (answer != DONE)
        return failed(it, answer);
    kept->bytes = malloc(it->worker.size);
    if (kept->bytes == NULL)
        return fail(it, "no memory for an FMU state of %zu bytes", it->worker.size);
    kept->size = it->worker.size;
    memcpy(kept->bytes, it->worker.reply, kept->size);
    return OK;
}

enum status packed_size(instance *it, void *kept, size_t *size)
{
    if (packed(it, kept) != OK)
        return ERROR;
    *size = ((state *)kept)->size;
    return OK;
}

enum status pack(instance *it, void *given, char *bytes, size_t size)
{
    state *kept = given;

    if (packed(it, kept) != OK)
        return ERROR;
    if (size < kept->size)
        return fail(it, "the FMU state has %zu bytes, the host gives room for %zu", kept->size, size);
    memcpy(bytes, kept->bytes, kept->size);
    return OK;
}

enum status unpack(instance *it, const char *bytes, size_t size, void **place)
{
    const uint64_t numbers = 4 + VARIABLES;
    const part parts[] = {{&numbers, sizeof numbers}, {bytes, size}};
    enum answer answer;
    state *kept;

    if (is_stopped(it))
        return ERROR;
    if (place == NULL)
        return fail(it, "the host gives no place for the FMU state");
    answer = worker_ask(&it->worker, UNPACK, parts, 2);
    if (answer != DONE)
        return failed(it, answer);
    kept = new_state(it);
    if (kept == NULL)
        return ERROR;
    if (it->worker.size != sizeof kept->number + sizeof kept->side) {
        free(kept);
        return fail(it, "the worker's reply is not a state");
    }
    memcpy(&kept->number, it->worker.reply, sizeof kept->number);
    memcpy(kept->side, it->worker.reply + sizeof kept->number, sizeof kept->side);
    if (!(kept->side[0] >= INSTANTIATED && kept->side[0] <= TERMINATED)) {
        forget(it, (void **)&kept);
        return fail(it, "the FMU state is damaged: it has no mode that there is");
    }
    if (*place != NULL)
        forget(it, place);
    *place = kept;
    return OK;
}

#define _GNU_SOURCE
#include "worker.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define LONGEST ((uint64_t)1 << 40) /* no reply is longer; a length beyond it is damage */
#define PATIENCE 2000               /* [ms] that a worker gets to end by itself */

extern char **environ;

static void pause_ms(long number)
{
    struct timespec left = {0, number * 1000000L};
    nanosleep(&left, NULL);
}

/* The way the process ended goes to `text`; waits, and ends it by force if it does not end. */
static void reap(worker *it)
{
    int status = 0, waited = 0;
    pid_t found;

    if (it->process == 0)
        return;
    while ((found = waitpid(it->process, &status, WNOHANG)) == 0 || (found < 0 && errno == EINTR)) {
        if (waited++ == PATIENCE)
            kill(it->process, SIGKILL);
        pause_ms(1);
    }
    if (found < 0) /* the host has reaped it */
        snprintf(it->text, sizeof it->text, "the worker process %ld has ended", (long)it->process);
    else if (WIFSIGNALED(status))
        snprintf(it->text, sizeof it->text, "the worker process %ld was ended by signal %d", (long)it->process,
                 WTERMSIG(status));
    else
        snprintf(it->text, sizeof it->text, "the worker process %ld has ended with exit code %d",
                 (long)it->process, WEXITSTATUS(status));
    it->process = 0;
}

static void hang_up(worker *it)
{
    if (it->socket >= 0)
        close(it->socket);
    it->socket = -1;
}

static enum answer broken(worker *it)
{
    hang_up(it);
    reap(it);
    return BROKEN;
}

/* MSG_NOSIGNAL: a worker that is gone must not end the host by SIGPIPE. */
static int send_all(int socket, const void *data, size_t size)
{
    const char *at = data;

    while (size > 0) {
        ssize_t sent = send(socket, at, size, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent <= 0)
            return 0;
        at += sent;
        size -= (size_t)sent;
    }
    return 1;
}

static int receive_all(int socket, void *data, size_t size)
{
    char *at = data;

    while (size > 0) {
        ssize_t found = recv(socket, at, size, 0);
        if (found < 0 && errno == EINTR)
            continue;
        if (found <= 0)
            return 0;
        at += found;
        size -= (size_t)found;
    }
    return 1;
}

static enum answer receive(worker *it)
{
    uint64_t header[2];

    if (!receive_all(it->socket, header, sizeof header))
        return broken(it);
    if (header[0] > STOPPED || header[1] > LONGEST) {
        hang_up(it);
        reap(it);
        snprintf(it->text, sizeof it->text, "the worker's reply is damaged");
        return BROKEN;
    }
    if (header[1] + 1 > it->room) {
        char *larger = realloc(it->reply, header[1] + 1);
        if (larger == NULL) {
            hang_up(it);
            reap(it);
            snprintf(it->text, sizeof it->text, "no memory for a reply of %llu bytes", (unsigned long long)header[1]);
            return BROKEN;
        }
        it->reply = larger;
        it->room = header[1] + 1;
    }
    it->size = header[1];
    if (!receive_all(it->socket, it->reply, it->size))
        return broken(it);
    it->reply[it->size] = '\0';
    return (enum answer)header[0];
}

/* The first line of a file, without its end; returns 0 if there is none. */
static int first_line(const char *path, char *line, size_t room)
{
    FILE *file = fopen(path, "re");
    int found;

    if (file == NULL)
        return 0;
    found = fgets(line, (int)room, file) != NULL;
    fclose(file);
    if (found)
        line[strcspn(line, "\r\n")] = '\0';
    return found && line[0] != '\0';
}

/* The host's environment without what its loader and its own Python read: these are not of the worker's Python.
   Returns a new array of the strings of `environ`, or NULL without memory. */
static char **environment_of_worker(void)
{
    static const char *const of_host[] = {"LD_", "PYTHON"};
    const size_t prefixes = sizeof of_host / sizeof of_host[0];
    size_t number = 0, k;
    char **variables, **to, **from;

    for (from = environ; from != NULL && *from != NULL; from++)
        number++;
    variables = to = malloc((number + 1) * sizeof *variables);
    if (variables == NULL)
        return NULL;
    for (from = environ; number > 0; from++, number--) {
        for (k = 0; k < prefixes && strncmp(*from, of_host[k], strlen(of_host[k])) != 0; k++)
            ;
        if (k == prefixes)
            *to++ = *from;
    }
    *to = NULL;
    return variables;
}

/* Start the process, with one end of a pair of sockets as its standard input. */
static int spawn(worker *it, char *const arguments[], int theirs)
{
    posix_spawn_file_actions_t files;
    posix_spawnattr_t how;
    sigset_t signals;
    char **variables = environment_of_worker();
    int error;

    if (variables == NULL)
        return ENOMEM;
    posix_spawn_file_actions_init(&files);
    posix_spawn_file_actions_adddup2(&files, theirs, 0);
    posix_spawn_file_actions_addopen(&files, 1, "/dev/null", O_WRONLY, 0);
    posix_spawnattr_init(&how);
    sigemptyset(&signals);
    posix_spawnattr_setsigmask(&how, &signals);
    sigfillset(&signals);
    posix_spawnattr_setsigdefault(&how, &signals);
    posix_spawnattr_setpgroup(&how, 0); /* so that Ctrl-C reaches the host only, which ends its workers */
    posix_spawnattr_setflags(&how, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
    error = posix_spawnp(&it->process, arguments[0], &files, &how, arguments, variables);
    posix_spawnattr_destroy(&how);
    posix_spawn_file_actions_destroy(&files);
    free(variables);
    if (error != 0)
        it->process = 0;
    return error;
}

enum answer worker_start(worker *it, const char *resources, const char *token)
{
    char python[4096], path[4096], script[4096];
    char *arguments[] = {python, "-P", script, NULL};
    const char *chosen = getenv("EXUNET_PYTHON");
    int ends[2], error, ours, theirs;
    enum answer answer;

    it->socket = -1;
    if ((size_t)snprintf(path, sizeof path, "%s/python.txt", resources) >= sizeof path ||
        (size_t)snprintf(script, sizeof script, "%s/start.py", resources) >= sizeof script) {
        snprintf(it->text, sizeof it->text, "the path of the FMU's resources is too long");
        return BROKEN;
    }
    if (chosen != NULL && chosen[0] != '\0')
        snprintf(python, sizeof python, "%s", chosen);
    else if (!first_line(path, python, sizeof python)) {
        snprintf(it->text, sizeof it->text, "%.300s cannot be read", path);
        return BROKEN;
    }
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
        snprintf(it->text, sizeof it->text, "no socket for the worker: %s", strerror(errno));
        return BROKEN;
    }
    /* Beyond 0, 1 and 2, which the host may have closed and the worker uses. */
    ours = fcntl(ends[0], F_DUPFD_CLOEXEC, 3);
    theirs = fcntl(ends[1], F_DUPFD_CLOEXEC, 3);
    close(ends[0]);
    close(ends[1]);
    error = ours < 0 || theirs < 0 ? EMFILE : spawn(it, arguments, theirs);
    if (theirs >= 0)
        close(theirs);
    it->socket = ours;
    if (error != 0) {
        hang_up(it);
        snprintf(it->text, sizeof it->text,
                 "the worker cannot be started: %.200s: %s. Let the environment variable EXUNET_PYTHON name a "
                 "Python that has exunet",
                 python, strerror(error));
        return BROKEN;
    }
    answer = receive(it);
    if (answer == BROKEN) {
        char ended[256];
        snprintf(ended, sizeof ended, "%.255s", it->text);
        snprintf(it->text, sizeof it->text,
                 "%s before it was ready (%.150s). Let the environment variable EXUNET_PYTHON name a Python that "
                 "has exunet",
                 ended, python);
    } else if (answer == DONE && strcmp(it->reply, token) != 0) {
        hang_up(it);
        reap(it);
        snprintf(it->text, sizeof it->text, "the FMU's binary and its resources are of two exports");
        return BROKEN;
    } else if (answer != DONE) { /* it has told why, and ends */
        hang_up(it);
        reap(it);
    }
    return answer;
}

enum answer worker_ask(worker *it, enum request what, const part *parts, int number)
{
    uint64_t header[2] = {what, 0};
    int k, sent;

    if (it->socket < 0)
        return BROKEN;
    for (k = 0; k < number; k++)
        header[1] += parts[k].size;
    sent = send_all(it->socket, header, sizeof header);
    for (k = 0; k < number && sent; k++)
        sent = send_all(it->socket, parts[k].data, parts[k].size);
    return sent ? receive(it) : broken(it);
}

void worker_end(worker *it)
{
    hang_up(it);
    reap(it);
    free(it->reply);
    it->reply = NULL;
    it->size = it->room = 0;
}

const char *worker_words(const worker *it, enum answer answer)
{
    return answer == BROKEN ? it->text : it->reply;
}

/* A plugin library that does what none should. How the library as a whole is wrong is chosen when it is compiled (LIBRARY_...),
 * what its model does wrong by its setting `mode`. It starts one process at most and 2000 threads, and touches none of the memory that it asks for. After `away-` it does so only where a parameter is not zero, and writes on
 * standard error every time that it is asked there. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "abbe_plugin.h"

typedef struct {
    char mode[32];
    int away;
    int is_stage;
} Bad;

static const Bad GOOD = { "good", 0, 0 };

static void say(const AbbeReply *reply, const char *text)
{
    AbbeText all = { text, strlen(text) };
    reply->text(reply->context, all);
}

static int is(const Bad *bad, const char *mode)
{
    return strcmp(bad->mode, mode) == 0;
}

static void *wait_a_second(void *unused)
{
    usleep(1000000);
    return unused;
}

/* Starts threads that wait for a second, and waits for their end; gives how many there were. */
static int threads(int count)
{
    static pthread_t all[2000];
    int started = 0;
    pthread_attr_t small;
    pthread_attr_init(&small);
    pthread_attr_setstacksize(&small, 64 << 10);
    while (started < count && pthread_create(&all[started], &small, wait_a_second, NULL) == 0)
        started++;
    for (int i = 0; i < started; i++)
        pthread_join(all[i], NULL);
    return started;
}

/* What no plugin needs to do: none if it cannot, or does not try. */
static const char *could(const Bad *bad)
{
    if (is(bad, "read"))
        return open("/etc/passwd", O_RDONLY) >= 0 ? "read a file of the system" : NULL;
    if (is(bad, "list"))
        return open("/", O_RDONLY | O_DIRECTORY) >= 0 ? "list a folder" : NULL;
    if (is(bad, "write"))
        return open("written-by-a-plugin", O_WRONLY | O_CREAT, 0600) >= 0 ? "write a file" : NULL;
    if (is(bad, "change"))
        return chmod("recipe.yaml", 0400) == 0 ? "change a file" : NULL;
    /* Its setting names this file, so that it may be read. */
    if (is(bad, "truncate"))
        return open("truncate", O_RDONLY | O_TRUNC) >= 0 ? "empty a file" : NULL;
    if (is(bad, "open-to-write"))
        return open("open-to-write", O_RDWR) >= 0 ? "open a file to write" : NULL;
    if (is(bad, "remove"))
        return unlink("remove") == 0 ? "remove a file" : NULL;
    if (is(bad, "rename"))
        return rename("rename", "renamed") == 0 ? "rename a file" : NULL;
    if (is(bad, "network"))
        return socket(AF_INET, SOCK_STREAM, 0) >= 0 ? "open a socket" : NULL;
    if (is(bad, "fork")) {
        pid_t child = fork();
        if (child == 0)
            _exit(0);
        return child > 0 && waitpid(child, NULL, 0) == child ? "start a process" : NULL;
    }
    if (is(bad, "signal"))
        return kill(getppid(), SIGWINCH) == 0 ? "signal to another process" : NULL;
    if (is(bad, "signal-group"))
        return kill(0, SIGWINCH) == 0 ? "signal to a group of processes" : NULL;
    if (is(bad, "signal-later"))
        return fcntl(0, F_SETOWN, getppid()) == 0 ? "have signals sent to another process" : NULL;
    if (is(bad, "shared-memory")) {
        void *much = mmap(NULL, (size_t)3 << 30, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
        return much != MAP_FAILED ? "have 3 GiB of shared memory" : NULL;
    }
    if (is(bad, "memory")) {
        size_t size = (size_t)3 << 30;
        char *volatile much = malloc(size);
        return much ? "have 3 GiB of memory" : NULL;
    }
    if (is(bad, "threads"))
        return threads(2000) == 2000 ? "start 2000 threads" : NULL;
    if (is(bad, "some-threads")) {
        static int started;
        return started++ || threads(100) == 100 ? NULL : "not start 100 threads";
    }
    if (is(bad, "environment"))
        return getenv("PATH") ? "read the environment" : NULL;
    return NULL;
}

static uint64_t deep(uint64_t n)
{
    volatile char room[4096];
    room[n % sizeof room] = 1;
    return n == UINT64_MAX ? 0 : deep(n + 1) + room[n % sizeof room];
}

/* Writes on the socket of an isolated plugin: a frame that is none, or one that never ends. */
static void forge(int drips)
{
    unsigned char head[16];
    memset(head, drips ? 0 : 0xff, sizeof head);
    head[1] = 0xff;
    if (write(0, head, sizeof head) < 0)
        return;
    while (drips && write(0, " ", 1) == 1)
        usleep(50000);
}

static uint32_t poses(void *handle, const AbbePoses *batch, const AbbeReply *reply)
{
    const Bad *bad = handle;
    if (bad->away) {
        int at_start = 1;
        for (uint64_t i = 0; i < batch->value_count; i++)
            at_start = at_start && batch->values[i] == 0;
        if (at_start)
            bad = &GOOD;
        else
            fputs("asked away from the start\n", stderr);
    }
    int *volatile nowhere = (int *)16;
    static void *volatile lost;
    if (is(bad, "abort"))
        abort();
    if (is(bad, "crash"))
        *nowhere = 1;
    if (is(bad, "exit"))
        exit(0);
    if (is(bad, "quick-exit"))
        _exit(0);
    if (is(bad, "exec"))
        execl("/bin/true", "true", (char *)NULL);
    if (is(bad, "stack"))
        deep(batch->value_count);
    if (is(bad, "hang"))
        for (;;)
            usleep(1000);
    if (is(bad, "slow"))
        usleep(400000);
    if (is(bad, "stdout")) {
        puts("{\"garbage\": true}");
        fflush(stdout);
    }
    if (is(bad, "flood"))
        for (int i = 0; i < 30000; i++)
            fputs("a line of a plugin that says far too much, and says it again and again and again, thirty thousand times\n", stderr);
    if (is(bad, "flood-stdout"))
        for (;;)
            puts("a line of a plugin that never ends");
    if (is(bad, "close"))
        for (int i = 0; i < 256; i++)
            close(i);
    if (is(bad, "forged") || is(bad, "drip"))
        forge(is(bad, "drip"));
    /* Once is enough: a file that was removed cannot be removed again. */
    static const char *done;
    if (!done)
        done = could(bad);
    if (done) {
        say(reply, done);
        return ABBE_FAILED;
    }
    if (is(bad, "fail")) {
        say(reply, "the vendor says no");
        return ABBE_FAILED;
    }
    if (is(bad, "fault")) {
        say(reply, "{\"message\":\"the licence has expired\",\"fault\":true}");
        return ABBE_FAILED_WITH_DETAILS;
    }
    if (is(bad, "panic")) {
        say(reply, "a bug of the vendor");
        return ABBE_PANICKED;
    }
    if (batch->orientations && !is(bad, "orientation")) {
        say(reply, "this machine gives no orientations");
        return ABBE_FAILED;
    }
    if (is(bad, "status"))
        return 77;
    if (is(bad, "not-utf8")) {
        say(reply, "\xff\xfe\xfd");
        return ABBE_FAILED;
    }
    if (is(bad, "leak")) {
        lost = malloc(200);
        memset(lost, 1, 200);
    }
    if (is(bad, "directory") && chdir("/") != 0)
        return ABBE_FAILED;
#if defined(__x86_64__)
    if (is(bad, "rounding")) {
        unsigned int word = __builtin_ia32_stmxcsr() | 0x8040;
        __builtin_ia32_ldmxcsr(word);
    }
#endif
    uint64_t beyond = is(bad, "beyond") ? 1 : 0;
    for (uint64_t pose = 0; pose < batch->pose_count + beyond; pose++)
        for (int i = 0; i < 3; i++) {
            double q = pose < batch->pose_count ? batch->statuses[3 * pose + i] : 0;
            batch->positions[3 * pose + i] = is(bad, "nan") ? NAN : is(bad, "zeros") ? 0 : is(bad, "stubborn") ? q : q * (1 + batch->values[i]);
        }
    for (uint64_t pose = 0; pose < batch->pose_count; pose++)
        for (uint64_t k = 0; k < batch->wanted_count; k++) {
            double *out = batch->position_derivatives + 3 * (pose * batch->wanted_count + k);
            uint32_t i = batch->wanted[k].index;
            if (is(bad, "zeros") || (is(bad, "stubborn") && batch->wanted[k].kind != 1))
                continue;
            if (is(bad, "stubborn")) {
                out[i] = 1;
                continue;
            }
            out[i] = batch->wanted[k].kind == 1 ? 1 + batch->values[i] : is(bad, "slope") ? 2 : batch->statuses[3 * pose + i];
        }
    static _Atomic uint64_t turn;
    if (is(bad, "random") && batch->pose_count > 0)
        batch->positions[0] += (double)(turn++ % 7);
    return ABBE_OK;
}

static uint32_t call(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply);

static _Atomic int stages;

static void release(void *handle)
{
    if (((Bad *)handle)->is_stage)
        stages--;
    free(handle);
}

static const AbbeTable TABLE = { sizeof(AbbeTable), NULL, release, call, poses, NULL };
static const AbbeTable NO_POSES = { sizeof(AbbeTable), NULL, release, call, NULL, NULL };

#define AXIS(name, index, x, y, z) \
    "{\"name\":\"" name "\",\"kind\":\"linear\",\"branch\":\"tool\",\"sense\":1,\"direction\":[" x "," y "," z "],\"status\":" index "}"
#define STATUS(name, axis) "{\"name\":\"" name "\",\"role\":{\"command\":" axis "},\"quantity\":\"length\",\"absent\":\"refused\"}"
#define REST(axis) "{\"axes\":[" AXIS("X", "0", "1", "0", "0") "," AXIS("Y", "1", "0", "1", "0") "," AXIS("Z", axis, "0", "0", "1") \
    "],\"status\":[" STATUS("X", "0") "," STATUS("Y", "1") "," STATUS("Z", "2") "],\"parameters\":[{\"name\":\"EXX[1]\",\"unit\":\"mm/mm\"}," \
    "{\"name\":\"EYY[1]\",\"unit\":\"mm/mm\"},{\"name\":\"EZZ[1]\",\"unit\":\"mm/mm\"}],\"settings\":{}}"

static uint32_t call(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply)
{
    Bad *bad = handle;
    (void)question;
    switch (method) {
    case ABBE_INPUTS:
        say(reply, "[]");
        return ABBE_OK;
    case ABBE_BUILD: {
        if (is(bad, "no-object"))
            return ABBE_OK;
        if (is(bad, "abort-in-build"))
            abort();
        Bad *machine = malloc(sizeof *machine);
        *machine = *bad;
        machine->is_stage = 0;
        AbbeObject object = { is(bad, "no-table") ? NULL : is(bad, "no-poses") ? &NO_POSES : &TABLE, machine };
        reply->object(reply->context, object);
        return ABBE_OK;
    }
    case ABBE_DESCRIBE:
        say(reply, is(bad, "no-json") ? "{\"axes\":" : is(bad, "wrong-axis") ? REST("9") : REST("2"));
        return ABBE_OK;
    default:
        return ABBE_UNKNOWN_METHOD;
    }
}

static uint32_t create(const AbbePlugin *plugin, AbbeText settings, AbbeText base, const AbbeReply *reply)
{
    static const char KEY[] = "{\"mode\":\"";
    (void)plugin;
    (void)base;
    Bad *bad = calloc(1, sizeof *bad);
    size_t skip = sizeof KEY - 1;
    if (settings.length < skip + 2 || memcmp(settings.data, KEY, skip) != 0 || settings.length - skip - 2 >= sizeof bad->mode ||
        settings.data[settings.length - 1] != '}' || memchr(settings.data, ',', settings.length)) {
        free(bad);
        say(reply, "one setting was expected: `mode`; perhaps `frobnicate` is unknown");
        return ABBE_FAILED;
    }
    memcpy(bad->mode, settings.data + skip, settings.length - skip - 2);
    if (strncmp(bad->mode, "away-", 5) == 0) {
        bad->away = 1;
        memmove(bad->mode, bad->mode + 5, sizeof bad->mode - 5);
    }
    if (is(bad, "abort-in-create"))
        abort();
    if (is(bad, "hang-in-create"))
        for (;;)
            usleep(1000);
    if (is(bad, "once") && stages > 0) {
        free(bad);
        say(reply, "there is one already");
        return ABBE_FAILED;
    }
    bad->is_stage = 1;
    stages++;
    AbbeObject object = { &TABLE, bad };
    reply->object(reply->context, object);
    return is(bad, "status-in-create") ? 78 : ABBE_OK;
}

#ifndef MODE
#define MODE "good"
#endif
#ifndef NAME
#define NAME "bad-model"
#endif

static const AbbePlugin MODEL = {
    sizeof(AbbePlugin), ABBE_MODEL, ABBE_TEXT(NAME), ABBE_TEXT("three axes that misbehave"),
    ABBE_TEXT("{\"type\":\"object\",\"properties\":{\"mode\":{\"type\":\"string\"}}}"), ABBE_TEXT("{\"mode\":\"" MODE "\"}"),
#ifdef LIBRARY_WITHOUT_CREATE
    NULL,
#else
    create,
#endif
    ABBE_TEXT(""),
};

static const AbbePlugin *const PLUGINS[] = {
#ifdef LIBRARY_WITH_NULL_PLUGIN
    NULL,
#else
    &MODEL,
#endif
};

#ifndef ABI
#define ABI ABBE_ABI_MAJOR
#endif

static const AbbeLibrary LIBRARY = {
    ABI, 0, sizeof(AbbeLibrary), ABBE_TEXT("bad"), ABBE_TEXT("0.1.0"), PLUGINS, 1,
};

#ifdef LIBRARY_LOOPS
__attribute__((constructor)) static void never_loaded(void)
{
    for (;;)
        usleep(1000);
}
#endif

#ifdef LIBRARY_WITHOUT_SYMBOL
#define abbe_plugin something_else
#endif

const AbbeLibrary *abbe_plugin(const AbbeHost *host)
{
    (void)host;
    (void)create;
    (void)MODEL;
#ifdef LIBRARY_CRASHES
    abort();
#endif
#ifdef LIBRARY_GIVES_NULL
    return NULL;
#endif
    return &LIBRARY;
}

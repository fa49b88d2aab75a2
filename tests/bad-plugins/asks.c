/* An estimator that asks for what is not there: in an isolated process it writes questions of its own on the socket, past the code
 * that would check them. It reads the answer and fails with what it was told. */
#define _GNU_SOURCE
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "abbe_plugin.h"

static char mode[32];

static void say(const AbbeReply *reply, const char *text)
{
    AbbeText all = { text, strlen(text) };
    reply->text(reply->context, all);
}

static int all_of(void *into, size_t length)
{
    for (size_t have = 0; have < length;) {
        ssize_t more = read(0, (char *)into + have, length - have);
        if (more <= 0)
            return 0;
        have += (size_t)more;
    }
    return 1;
}

/* Asks with this frame and so many numbers, all of this value; gives the beginning of the answer. */
static const char *ask(const char *frame, uint64_t count, double value)
{
    static char answer[4096];
    uint64_t lengths[2] = { strlen(frame), count };
    if (write(0, lengths, sizeof lengths) < 0 || write(0, frame, lengths[0]) < 0)
        return "nobody listens";
    double block[1024];
    for (size_t i = 0; i < 1024; i++)
        block[i] = value;
    for (uint64_t left = count * sizeof value; left > 0;) {
        ssize_t written = write(0, block, left < sizeof block ? left : sizeof block);
        if (written < 0)
            return "nobody listens";
        left -= (uint64_t)written;
    }
    memset(answer, 0, sizeof answer);
    if (!all_of(lengths, sizeof lengths) || lengths[0] + 8 * lengths[1] >= sizeof answer)
        return "no answer, or a long one";
    return all_of(answer, lengths[0] + 8 * lengths[1]) ? answer : "half an answer";
}

static uint32_t call(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply)
{
    static const struct { const char *mode, *frame; uint64_t count; double value; } ASKED[] = {
        { "good", "{\"Poses\":{\"object\":0,\"lengths\":[3,3,1],\"orientation\":false}}", 7, 0 },
        { "statuses", "{\"Poses\":{\"object\":0,\"lengths\":[4,3,0],\"orientation\":false}}", 7, 0 },
        { "values", "{\"Poses\":{\"object\":0,\"lengths\":[3,1,0],\"orientation\":false}}", 4, 0 },
        { "wanted", "{\"Poses\":{\"object\":0,\"lengths\":[3,3,1],\"orientation\":false}}", 7, 1e9 },
        { "room", "{\"Poses\":{\"object\":0,\"lengths\":[3000,3,60000],\"orientation\":false}}", 63003, 0 },
        { "rows", "{\"Equations\":{\"object\":1,\"lengths\":[1,6,0,0,0]}}", 7, 1e9 },
        { "positions", "{\"Equations\":{\"object\":1,\"lengths\":[1,0,0,0,0]}}", 1, 0 },
        { "contact", "{\"Call\":{\"object\":1,\"method\":10,\"text\":\"{\\\"row\\\":99999,\\\"tip\\\":[0,0,0],\\\"own\\\":[],\\\"inputs\\\":[]}\",\"objects\":[]}}", 0, 0 },
        { "nobody", "{\"Poses\":{\"object\":77,\"lengths\":[3,3,0],\"orientation\":false}}", 6, 0 },
        { "answer", "{\"Release\":{\"object\":0}}{\"Release\":", 0, 0 },
    };
    (void)handle;
    (void)method;
    if (question->object_count == 0) {
        say(reply, "{}");
        return ABBE_OK;
    }
    for (size_t i = 0; i < sizeof ASKED / sizeof *ASKED; i++)
        if (strcmp(mode, ASKED[i].mode) == 0) {
            static char told[5000];
            snprintf(told, sizeof told, "it was told: %s", ask(ASKED[i].frame, ASKED[i].count, ASKED[i].value));
            say(reply, told);
        }
    return ABBE_FAILED;
}

static const AbbeTable TABLE = { sizeof(AbbeTable), NULL, NULL, call, NULL, NULL };

static uint32_t create(const AbbePlugin *plugin, AbbeText settings, AbbeText base, const AbbeReply *reply)
{
    static const char KEY[] = "{\"mode\":\"";
    size_t skip = sizeof KEY - 1;
    (void)plugin;
    (void)base;
    if (settings.length < skip + 2 || settings.length - skip - 2 >= sizeof mode || memcmp(settings.data, KEY, skip) != 0) {
        say(reply, "one setting was expected: `mode`");
        return ABBE_FAILED;
    }
    memcpy(mode, settings.data + skip, settings.length - skip - 2);
    AbbeObject object = { &TABLE, mode };
    reply->object(reply->context, object);
    return ABBE_OK;
}

static const AbbePlugin ESTIMATOR = {
    sizeof(AbbePlugin), ABBE_ESTIMATE, ABBE_TEXT("asks"), ABBE_TEXT("an estimator that asks for what is not there"),
    ABBE_TEXT("{\"type\":\"object\",\"properties\":{\"mode\":{\"type\":\"string\"}}}"), ABBE_TEXT("{\"mode\":\"good\"}"), create,
    ABBE_TEXT(""),
};

static const AbbePlugin *const PLUGINS[] = { &ESTIMATOR };
static const AbbeLibrary LIBRARY = {
    ABBE_ABI_MAJOR, 0, sizeof(AbbeLibrary), ABBE_TEXT("asks"), ABBE_TEXT("0.1.0"), PLUGINS, 1,
};

const AbbeLibrary *abbe_plugin(const AbbeHost *host)
{
    (void)host;
    return &LIBRARY;
}

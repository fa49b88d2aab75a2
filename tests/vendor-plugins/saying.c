/* A plugin library with a validator `vendor-saying`, which finds what its setting `findings` says: figures as a vendor of any version
 * may send them. */
#include <stdlib.h>
#include <string.h>

#include "abbe_plugin.h"

typedef struct {
    size_t length;
    char text[];
} Findings;

static void say(const AbbeReply *reply, const char *data, size_t length)
{
    AbbeText text = { data, length };
    reply->text(reply->context, text);
}

static void release(void *handle)
{
    free(handle);
}

static uint32_t call(void *handle, uint32_t method, const AbbeQuestion *question, const AbbeReply *reply)
{
    const Findings *findings = handle;
    (void)question;
    switch (method) {
    case ABBE_INPUTS:
    case ABBE_OBSERVATIONS:
        say(reply, "[]", 2);
        return ABBE_OK;
    case ABBE_JUDGE:
        say(reply, findings->text, findings->length);
        return ABBE_OK;
    default:
        return ABBE_UNKNOWN_METHOD;
    }
}

static const AbbeTable TABLE = { sizeof(AbbeTable), NULL, release, call, NULL, NULL };

static uint32_t create(const AbbePlugin *plugin, AbbeText settings, AbbeText base, const AbbeReply *reply)
{
    static const char KEY[] = "{\"findings\":";
    size_t key = sizeof KEY - 1;
    (void)plugin;
    (void)base;
    if (settings.length < key + 1 || memcmp(settings.data, KEY, key) != 0) {
        static const char WRONG[] = "one setting was expected: `findings`";
        say(reply, WRONG, sizeof WRONG - 1);
        return ABBE_FAILED;
    }
    size_t length = settings.length - key - 1;
    Findings *findings = malloc(sizeof *findings + length);
    findings->length = length;
    memcpy(findings->text, settings.data + key, length);
    AbbeObject object = { &TABLE, findings };
    reply->object(reply->context, object);
    return ABBE_OK;
}

static const AbbePlugin SAYING = {
    sizeof(AbbePlugin), ABBE_VALIDATE, ABBE_TEXT("vendor-saying"), ABBE_TEXT("finds what it is told"),
    ABBE_TEXT("{\"type\":\"object\",\"properties\":{\"findings\":{\"type\":\"object\"}},\"additionalProperties\":false}"),
    ABBE_TEXT("{\"findings\":{\"figures\":[],\"remarks\":[]}}"), create, ABBE_TEXT(""),
};

static const AbbePlugin *const PLUGINS[] = { &SAYING };

static const AbbeLibrary LIBRARY = {
    ABBE_ABI_MAJOR, 0, sizeof(AbbeLibrary), ABBE_TEXT("saying"), ABBE_TEXT("0.1.0"), PLUGINS, 1,
};

const AbbeLibrary *abbe_plugin(const AbbeHost *host)
{
    (void)host;
    return &LIBRARY;
}

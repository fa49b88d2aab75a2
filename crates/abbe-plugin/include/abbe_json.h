/* JSON for plugins in C and C++: reads what Abbe asks, writes what it is answered. It needs the C library alone.
 *
 * A value is a place in a text. It is read where it stands, without memory of its own, as long as the text is there:
 *
 *     AbbeJson settings = abbe_json(text);
 *     double length;
 *     if (!abbe_json_number(abbe_json_member(settings, "tool_length_mm"), &length))
 *         ...                                        (it is missing, or no number)
 *
 * A value that is missing, or of another kind, gives nothing further, so that only the last step has to be looked at.
 * A writer puts commas by itself:
 *
 *     AbbeJsonWriter answer = { 0 };
 *     abbe_json_open(&answer, '{');
 *     abbe_json_key(&answer, "value");
 *     abbe_json_put_number(&answer, 1.5);
 *     abbe_json_close(&answer, '}');
 *     return abbe_json_reply(&answer, reply, ABBE_OK);
 */
#ifndef ABBE_JSON_H
#define ABBE_JSON_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "abbe_plugin.h"

/* Lists and maps that may stand in each other. */
#define ABBE_JSON_DEPTH 256

/* A value in a text; `at` is null if there is none. */
typedef struct AbbeJson {
    const char *at;
    const char *end;
} AbbeJson;

/* An item of a list or a member of a map, while these are gone through. */
typedef struct AbbeJsonItem {
    /* The name of a member, with its quotation marks; none in lists. */
    AbbeJson key;
    AbbeJson value;
    /* What comes after it. */
    const char *rest;
    const char *end;
    int is_map;
} AbbeJsonItem;

/* ---- Where a value ends: null if it is no JSON -------------------------------------------------------------------- */

static inline const char *abbe_json_skip_blanks(const char *at, const char *end)
{
    while (at < end && (*at == ' ' || *at == '\t' || *at == '\n' || *at == '\r'))
        at++;
    return at;
}

static inline const char *abbe_json_skip_digits(const char *at, const char *end)
{
    const char *start = at;
    while (at < end && *at >= '0' && *at <= '9')
        at++;
    return at > start ? at : NULL;
}

static inline const char *abbe_json_skip_number(const char *at, const char *end)
{
    if (at < end && *at == '-')
        at++;
    if (at < end && *at == '0')
        at++;
    else if (!(at = abbe_json_skip_digits(at, end)))
        return NULL;
    if (at < end && *at == '.' && !(at = abbe_json_skip_digits(at + 1, end)))
        return NULL;
    if (at < end && (*at == 'e' || *at == 'E')) {
        at++;
        if (at < end && (*at == '+' || *at == '-'))
            at++;
        return abbe_json_skip_digits(at, end);
    }
    return at;
}

/* The four digits of an escape; -1 if they are none. */
static inline int abbe_json_hex(const char *at, const char *end)
{
    int code = 0;
    if (end - at < 4)
        return -1;
    for (int i = 0; i < 4; i++) {
        static const char DIGITS[] = "0123456789abcdefABCDEF";
        const char *digit = at[i] ? strchr(DIGITS, at[i]) : NULL;
        if (!digit)
            return -1;
        code = 16 * code + (int)(digit - DIGITS < 16 ? digit - DIGITS : digit - DIGITS - 6);
    }
    return code;
}

static inline const char *abbe_json_skip_text(const char *at, const char *end)
{
    for (at++; at < end && *at != '"'; at++) {
        if ((unsigned char)*at < 0x20)
            return NULL;
        if (*at != '\\')
            continue;
        if (++at == end || !strchr("\"\\/bfnrtu", *at) || !*at || (*at == 'u' && abbe_json_hex(at + 1, end) < 0))
            return NULL;
    }
    return at < end ? at + 1 : NULL;
}

static inline const char *abbe_json_skip_word(const char *at, const char *end, const char *word)
{
    size_t length = strlen(word);
    return (size_t)(end - at) >= length && memcmp(at, word, length) == 0 ? at + length : NULL;
}

static inline const char *abbe_json_skip(const char *at, const char *end, int depth)
{
    if (at >= end || depth > ABBE_JSON_DEPTH)
        return NULL;
    switch (*at) {
    case '"': return abbe_json_skip_text(at, end);
    case 't': return abbe_json_skip_word(at, end, "true");
    case 'f': return abbe_json_skip_word(at, end, "false");
    case 'n': return abbe_json_skip_word(at, end, "null");
    case '{':
    case '[': break;
    default: return abbe_json_skip_number(at, end);
    }
    char close = *at == '{' ? '}' : ']';
    at = abbe_json_skip_blanks(at + 1, end);
    if (at < end && *at == close)
        return at + 1;
    for (;;) {
        if (close == '}') {
            if (at >= end || *at != '"' || !(at = abbe_json_skip_text(at, end)))
                return NULL;
            at = abbe_json_skip_blanks(at, end);
            if (at >= end || *at != ':')
                return NULL;
            at = abbe_json_skip_blanks(at + 1, end);
        }
        if (!(at = abbe_json_skip(at, end, depth + 1)))
            return NULL;
        at = abbe_json_skip_blanks(at, end);
        if (at < end && *at == close)
            return at + 1;
        if (at >= end || *at != ',')
            return NULL;
        at = abbe_json_skip_blanks(at + 1, end);
    }
}

/* ---- Reading ------------------------------------------------------------------------------------------------------ */

/* The value that a text is; none if the text is no JSON. */
static inline AbbeJson abbe_json(AbbeText text)
{
    AbbeJson none = { NULL, NULL };
    if (text.length == 0)
        return none;
    const char *end = text.data + text.length, *at = abbe_json_skip_blanks(text.data, end);
    const char *after = abbe_json_skip(at, end, 0);
    if (!after || abbe_json_skip_blanks(after, end) != end)
        return none;
    AbbeJson value = { at, after };
    return value;
}

static inline int abbe_json_is_map(AbbeJson value) { return value.at && *value.at == '{'; }
static inline int abbe_json_is_list(AbbeJson value) { return value.at && *value.at == '['; }
static inline int abbe_json_is_text(AbbeJson value) { return value.at && *value.at == '"'; }
static inline int abbe_json_is_null(AbbeJson value) { return value.at && *value.at == 'n'; }

/* Before the first item of a list or map: `for (AbbeJsonItem item = abbe_json_items(list); abbe_json_next(&item);)`. */
static inline AbbeJsonItem abbe_json_items(AbbeJson value)
{
    AbbeJsonItem item;
    memset(&item, 0, sizeof item);
    item.is_map = abbe_json_is_map(value);
    if (item.is_map || abbe_json_is_list(value)) {
        item.rest = value.at + 1;
        item.end = value.end - 1;
    }
    return item;
}

/* Goes to the next item; 0 if there is none. */
static inline int abbe_json_next(AbbeJsonItem *item)
{
    if (!item->rest)
        return 0;
    const char *at = abbe_json_skip_blanks(item->rest, item->end);
    if (at >= item->end)
        return 0;
    if (*at == ',')
        at = abbe_json_skip_blanks(at + 1, item->end);
    if (item->is_map) {
        item->key.at = at;
        item->key.end = at = abbe_json_skip_text(at, item->end);
        at = abbe_json_skip_blanks(at, item->end);
        at = abbe_json_skip_blanks(at + 1, item->end);
    }
    item->value.at = at;
    item->value.end = item->rest = abbe_json_skip(at, item->end, 0);
    return 1;
}

/* The number of items or members; 0 of what is neither list nor map. */
static inline uint64_t abbe_json_count(AbbeJson value)
{
    uint64_t count = 0;
    for (AbbeJsonItem item = abbe_json_items(value); abbe_json_next(&item);)
        count++;
    return count;
}

/* An item of a list, counted from 0. To read all, go through them with `abbe_json_next`. */
static inline AbbeJson abbe_json_item(AbbeJson list, uint64_t index)
{
    AbbeJson none = { NULL, NULL };
    AbbeJsonItem item = abbe_json_items(list);
    if (item.is_map)
        return none;
    do {
        if (!abbe_json_next(&item))
            return none;
    } while (index-- > 0);
    return item.value;
}

/* A number; `null` is a number that is not known, NaN. Gives 0 for all else, and for numbers of more than 100
 * characters. */
static inline int abbe_json_number(AbbeJson value, double *number)
{
    char text[104];
    if (abbe_json_is_null(value)) {
        *number = NAN;
        return 1;
    }
    if (!value.at || !(*value.at == '-' || (*value.at >= '0' && *value.at <= '9')) || value.end - value.at > 100)
        return 0;
    memcpy(text, value.at, (size_t)(value.end - value.at));
    text[value.end - value.at] = 0;
    *number = strtod(text, NULL);
    return 1;
}

/* `true` or `false`; gives 0 for all else. */
static inline int abbe_json_truth(AbbeJson value, int *truth)
{
    if (!value.at || (*value.at != 't' && *value.at != 'f'))
        return 0;
    *truth = *value.at == 't';
    return 1;
}

/* One character of a text as UTF-8; gives its bytes, and moves on. A half of a pair alone becomes U+FFFD. */
static inline int abbe_json_character(const char **from, const char *end, char out[4])
{
    const char *at = *from;
    if (*at != '\\') {
        int count = 0;
        do
            out[count++] = *at++;
        while (count < 4 && at < end && ((unsigned char)*at & 0xc0) == 0x80);
        *from = at;
        return count;
    }
    const char *known = "\"\\/bfnrt", *means = "\"\\/\b\f\n\r\t", *found = at[1] == 'u' ? NULL : strchr(known, at[1]);
    if (found) {
        out[0] = means[found - known];
        *from = at + 2;
        return 1;
    }
    unsigned long code = (unsigned long)abbe_json_hex(at + 2, end);
    at += 6;
    if (code >= 0xd800 && code < 0xdc00 && end - at >= 6 && at[0] == '\\' && at[1] == 'u') {
        unsigned long low = (unsigned long)abbe_json_hex(at + 2, end);
        if (low >= 0xdc00 && low < 0xe000) {
            code = 0x10000 + ((code - 0xd800) << 10) + (low - 0xdc00);
            at += 6;
        }
    }
    *from = at;
    if (code >= 0xd800 && code < 0xe000)
        code = 0xfffd;
    int bytes = code < 0x80 ? 1 : code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
    static const unsigned char FIRST[] = { 0, 0, 0xc0, 0xe0, 0xf0 };
    for (int i = bytes - 1; i > 0; i--, code >>= 6)
        out[i] = (char)(0x80 | (code & 0x3f));
    out[0] = (char)(FIRST[bytes] | code);
    return bytes;
}

/* A text without its escapes, with a zero at its end; what does not fit into `size` bytes is left out. Gives the bytes
 * of the whole text, -1 for what is no text. */
static inline int64_t abbe_json_text(AbbeJson value, char *out, size_t size)
{
    int64_t length = 0;
    char one[4];
    if (size > 0)
        out[0] = 0;
    if (!abbe_json_is_text(value))
        return -1;
    size_t written = 0;
    int fits = 1;
    for (const char *at = value.at + 1, *end = value.end - 1; at < end;) {
        int bytes = abbe_json_character(&at, end, one);
        fits = fits && written + (size_t)bytes < size;
        if (fits) {
            memcpy(out + written, one, (size_t)bytes);
            written += (size_t)bytes;
            out[written] = 0;
        }
        length += bytes;
    }
    return length;
}

/* Whether a text is this one. */
static inline int abbe_json_is(AbbeJson value, const char *text)
{
    char one[4];
    if (!abbe_json_is_text(value))
        return 0;
    for (const char *at = value.at + 1, *end = value.end - 1; at < end;) {
        int bytes = abbe_json_character(&at, end, one);
        if (strncmp(text, one, (size_t)bytes) != 0 || memchr(one, 0, (size_t)bytes))
            return 0;
        text += bytes;
    }
    return *text == 0;
}

/* The member of a map with this name; none if there is none. */
static inline AbbeJson abbe_json_member(AbbeJson map, const char *name)
{
    AbbeJson none = { NULL, NULL };
    AbbeJsonItem item = abbe_json_items(map);
    while (item.is_map && abbe_json_next(&item))
        if (abbe_json_is(item.key, name))
            return item.value;
    return none;
}

/* ---- Writing ------------------------------------------------------------------------------------------------------ */

/* A text that grows. It begins with zeros; `abbe_json_reply` lets go of its memory. */
typedef struct AbbeJsonWriter {
    char *data;
    size_t length;
    size_t room;
    int failed;
} AbbeJsonWriter;

static inline void abbe_json_bytes(AbbeJsonWriter *writer, const char *bytes, size_t count)
{
    if (writer->failed)
        return;
    if (writer->room - writer->length < count) {
        size_t room = 2 * writer->room + count + 256;
        char *data = room > count ? (char *)realloc(writer->data, room) : NULL;
        if (!data) {
            writer->failed = 1;
            return;
        }
        writer->data = data;
        writer->room = room;
    }
    memcpy(writer->data + writer->length, bytes, count);
    writer->length += count;
}

/* Values follow each other with commas between them, but not after a key and at a beginning. */
static inline void abbe_json_comma(AbbeJsonWriter *writer)
{
    if (writer->length > 0 && !strchr("{[:", writer->data[writer->length - 1]))
        abbe_json_bytes(writer, ",", 1);
}

/* JSON as it is written: `true`, `null`, a whole value. */
static inline void abbe_json_put(AbbeJsonWriter *writer, const char *json)
{
    abbe_json_comma(writer);
    abbe_json_bytes(writer, json, strlen(json));
}

/* Begins a map '{' or a list '['. */
static inline void abbe_json_open(AbbeJsonWriter *writer, char bracket)
{
    abbe_json_comma(writer);
    abbe_json_bytes(writer, &bracket, 1);
}

/* Ends a map '}' or a list ']'. */
static inline void abbe_json_close(AbbeJsonWriter *writer, char bracket)
{
    abbe_json_bytes(writer, &bracket, 1);
}

/* A number; `null` if it is not finite. */
static inline void abbe_json_put_number(AbbeJsonWriter *writer, double number)
{
    char text[32];
    snprintf(text, sizeof text, "%.17g", number);
    abbe_json_put(writer, isfinite(number) ? text : "null");
}

/* A text of UTF-8. */
static inline void abbe_json_put_text(AbbeJsonWriter *writer, const char *text)
{
    abbe_json_comma(writer);
    abbe_json_bytes(writer, "\"", 1);
    for (; *text; text++) {
        char escape[8];
        if (*text == '"' || *text == '\\' || (unsigned char)*text < 0x20) {
            snprintf(escape, sizeof escape, "\\u%04x", (unsigned)(unsigned char)*text);
            abbe_json_bytes(writer, escape, 6);
        } else
            abbe_json_bytes(writer, text, 1);
    }
    abbe_json_bytes(writer, "\"", 1);
}

/* The name of the next member of a map. */
static inline void abbe_json_key(AbbeJsonWriter *writer, const char *name)
{
    abbe_json_put_text(writer, name);
    abbe_json_bytes(writer, ":", 1);
}

/* Gives the text to a reply and lets go of its memory. Gives `status`, or that there was no memory. */
static inline uint32_t abbe_json_reply(AbbeJsonWriter *writer, const AbbeReply *reply, uint32_t status)
{
    AbbeText text = { writer->data, writer->length };
    if (writer->failed) {
        static const char NO_MEMORY[] = "no memory for an answer";
        text.data = NO_MEMORY;
        text.length = sizeof NO_MEMORY - 1;
        status = ABBE_FAILED;
    }
    reply->text(reply->context, text);
    free(writer->data);
    memset(writer, 0, sizeof *writer);
    return status;
}

#endif

/* Reads texts from standard input and writes them again by `abbe_json.h`: each is preceded by its length (4 bytes); what is no JSON
 * becomes an empty text. With an argument it looks up that member of each map instead. */
#include <stdlib.h>

#include "abbe_json.h"

static void again(AbbeJsonWriter *to, AbbeJson value)
{
    double number;
    int truth;
    if (abbe_json_is_map(value) || abbe_json_is_list(value)) {
        abbe_json_open(to, *value.at);
        uint64_t count = 0;
        for (AbbeJsonItem item = abbe_json_items(value); abbe_json_next(&item); count++) {
            if (item.is_map) {
                char *name = malloc((size_t)(item.key.end - item.key.at));
                abbe_json_text(item.key, name, (size_t)(item.key.end - item.key.at));
                if (!abbe_json_is(item.key, name) && !strstr(item.key.at, "\\u0000"))
                    abort();
                abbe_json_key(to, name);
                free(name);
            } else if (abbe_json_item(value, count).at != item.value.at)
                abort();
            again(to, item.value);
        }
        if (count != abbe_json_count(value))
            abort();
        abbe_json_close(to, abbe_json_is_map(value) ? '}' : ']');
    } else if (abbe_json_is_text(value)) {
        char small[8], *text = malloc((size_t)(value.end - value.at));
        int64_t length = abbe_json_text(value, text, (size_t)(value.end - value.at));
        if (abbe_json_text(value, small, sizeof small) != length || strlen(small) >= sizeof small)
            abort();
        abbe_json_put_text(to, text);
        free(text);
    } else if (abbe_json_truth(value, &truth))
        abbe_json_put(to, truth ? "true" : "false");
    else if (abbe_json_number(value, &number))
        abbe_json_put_number(to, number);
    else
        abbe_json_put(to, "\"a long number\"");
}

static void write_text(void *context, AbbeText text)
{
    (void)context;
    uint32_t length = (uint32_t)text.length;
    fwrite(&length, sizeof length, 1, stdout);
    if (length > 0)
        fwrite(text.data, 1, length, stdout);
}

int main(int count, char **arguments)
{
    AbbeReply reply = { sizeof(AbbeReply), NULL, write_text, NULL };
    for (uint32_t length; fread(&length, sizeof length, 1, stdin) == 1;) {
        /* As long as the text and no longer, so that reading beyond it is found out. */
        char *bytes = malloc(length);
        if (fread(bytes, 1, length, stdin) != length)
            return 1;
        AbbeText text = { bytes, length };
        AbbeJson value = abbe_json(text);
        AbbeJsonWriter to = { 0 };
        if (count > 1)
            value = abbe_json_member(value, arguments[1]);
        if (value.at)
            again(&to, value);
        abbe_json_reply(&to, &reply, ABBE_OK);
        free(bytes);
    }
    return 0;
}

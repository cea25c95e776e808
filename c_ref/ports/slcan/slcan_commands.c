/* Commands that hosts send to an adapter. */
#include "slcan_link.h"

/* Only an adapter answers: two programs that answer each other's answers would never end. */
void slcan_answer(slcan_link_t *link, const char *text)
{
    uint8_t length = 0;
    while (text[length] != '\0') {
        ++length;
    }
    if (link->is_adapter) {
        (void)slcan_put(link, text, length);
    }
}

static void answer_host(slcan_link_t *link, const char *text)
{
    link->is_open &= link->is_adapter; /* what was open is the bus of an adapter that is not there */
    link->is_adapter = true;
    slcan_answer(link, text);
}

/* Bit 1: lines unsent; bit 3: lines dropped. */
static void answer_flags(slcan_link_t *link)
{
    const char *const unsent = link->dropped > 0 ? "F0A\r" : "F02\r";
    const char *const sent = link->dropped > 0 ? "F08\r" : "F00\r";
    slcan_answer(link, link->unsent > 0 ? unsent : sent);
}

static slcan_event_t open(slcan_link_t *link)
{
    const slcan_event_t event = link->is_open ? SLCAN_NOTHING : SLCAN_OPENED;
    link->is_open = true;
    return event;
}

/* The line's first character if its length is right: noise turns a T into a V by one bit. */
static char command_on(const slcan_link_t *link)
{
    if (link->length == 0) {
        return '\r';
    }
    const char first = link->line[0];
    uint8_t right = 1;
    if (first == 'S' || first == 's') {
        right = first == 'S' ? 2 : 5;
    }
    if (link->length == right) {
        return first;
    }
    return '?';
}

/* C and F may also be the end of a frame that noise has cut in two: they do not show that there is a host. */
slcan_event_t slcan_obey(slcan_link_t *link)
{
    switch (command_on(link)) {
    case 'O':
        answer_host(link, "\r");
        link->is_open = false;
        return open(link);
    case 'S': /* bit rates are granted: there is no wire that they would matter to */
    case 's':
        answer_host(link, "\r");
        break;
    case 'V':
        answer_host(link, "V1001\r");
        break;
    case 'N':
        answer_host(link, "NASDF\r");
        break;
    case 'C':
        link->is_open &= !link->is_adapter;
        slcan_answer(link, "\r");
        break;
    case 'F':
        answer_flags(link);
        break;
    case '\r': /* an empty line: a host clears it, or an adapter agrees to the opening */
        slcan_answer(link, "\r");
        return link->is_adapter ? SLCAN_NOTHING : open(link);
    case 'z': /* an adapter has sent what we gave it */
    case 'Z':
        break;
    default:
        slcan_drop(link);
    }
    return SLCAN_NOTHING;
}

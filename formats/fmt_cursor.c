#include <string.h>

#include "fmt_container.h"

const uint8_t *fmt_cursor_take(fmt_cursor *c, uint64_t size)
{
    if (!c->ok || size > c->size - c->at) {
        c->ok = false;
        return NULL;
    }
    const uint8_t *p = c->data + c->at;
    c->at += size;
    return p;
}

uint8_t fmt_cursor_u8(fmt_cursor *c)
{
    const uint8_t *p = fmt_cursor_take(c, 1);
    return p != NULL ? p[0] : 0;
}

uint16_t fmt_cursor_u16(fmt_cursor *c)
{
    const uint8_t *p = fmt_cursor_take(c, 2);
    return p != NULL ? fmt_load16(p) : 0;
}

uint32_t fmt_cursor_u32(fmt_cursor *c)
{
    const uint8_t *p = fmt_cursor_take(c, 4);
    return p != NULL ? fmt_load32(p) : 0;
}

uint64_t fmt_cursor_u64(fmt_cursor *c)
{
    const uint8_t *p = fmt_cursor_take(c, 8);
    return p != NULL ? fmt_load64(p) : 0;
}

double fmt_cursor_f64(fmt_cursor *c)
{
    uint64_t bits = fmt_cursor_u64(c);
    double v;
    memcpy(&v, &bits, 8);
    return v;
}

#include "svo_spill.h"

#include <string.h>

svo_result svo_spill_open(const svo_spill *spill, svo_spill_file *out, svo_error *err)
{
    svo_spill_file f = {.spill = spill};
    SVO_TRY(spill->create(spill->user, &f.file, err));
    *out = f;
    return SVO_OK;
}

void svo_spill_close(svo_spill_file *f)
{
    if (f->spill != NULL) f->spill->close(f->spill->user, f->file);
    memset(f, 0, sizeof *f);
}

svo_result svo_spill_write(const svo_spill_file *f, uint64_t offset, const void *bytes, uint64_t size, svo_error *err)
{
    return size != 0 ? f->spill->write(f->spill->user, f->file, offset, bytes, size, err) : SVO_OK;
}

svo_result svo_spill_read(const svo_spill_file *f, uint64_t offset, void *bytes, uint64_t size, svo_error *err)
{
    return size != 0 ? f->spill->read(f->spill->user, f->file, offset, bytes, size, err) : SVO_OK;
}

void svo_spill_discard(const svo_spill_file *f, uint64_t offset, uint64_t size)
{
    if (size != 0 && f->spill->discard != NULL) f->spill->discard(f->spill->user, f->file, offset, size);
}

svo_result svo_spill_append(svo_spill_file *f, const void *bytes, uint64_t size, svo_error *err)
{
    SVO_TRY(svo_spill_write(f, f->size, bytes, size, err));
    f->size += size;
    return SVO_OK;
}

void svo_spill_writer_init(svo_spill_writer *w, const svo_spill_file *f, uint64_t begin, uint8_t *buffer, uint32_t capacity)
{
    *w = (svo_spill_writer){.file = f, .offset = begin, .buffer = buffer, .capacity = capacity};
}

svo_result svo_spill_flush(svo_spill_writer *w, svo_error *err)
{
    SVO_TRY(svo_spill_write(w->file, w->offset, w->buffer, w->used, err));
    w->offset += w->used;
    w->used = 0;
    return SVO_OK;
}

svo_result svo_spill_put(svo_spill_writer *w, const void *bytes, uint64_t size, svo_error *err)
{
    if (size > w->capacity - w->used) SVO_TRY(svo_spill_flush(w, err));
    if (size >= w->capacity) {
        SVO_TRY(svo_spill_write(w->file, w->offset, bytes, size, err));
        w->offset += size;
        return SVO_OK;
    }
    memcpy(w->buffer + w->used, bytes, (size_t)size);
    w->used += (uint32_t)size;
    return SVO_OK;
}

void svo_spill_reader_init(svo_spill_reader *r, const svo_spill_file *f, uint64_t begin, uint64_t end, bool consume, uint8_t *buffer,
                           uint32_t capacity)
{
    *r = (svo_spill_reader){.file = f, .next = begin, .end = end, .buffer = buffer, .capacity = capacity, .consume = consume};
}

static svo_result take(svo_spill_reader *r, void *to, uint64_t size, svo_error *err)
{
    SVO_TRY(svo_spill_read(r->file, r->next, to, size, err));
    if (r->consume) svo_spill_discard(r->file, r->next, size);
    r->next += size;
    return SVO_OK;
}

svo_result svo_spill_get(svo_spill_reader *r, void *bytes, uint64_t size, svo_error *err)
{
    SVO_ASSERT(size <= svo_spill_left(r));
    uint8_t *to = bytes;
    while (size != 0) {
        if (r->at == r->filled) {
            r->at = r->filled = 0;
            if (size >= r->capacity) return take(r, to, size, err);
            uint64_t n = r->end - r->next < r->capacity ? r->end - r->next : r->capacity;
            SVO_TRY(take(r, r->buffer, n, err));
            r->filled = (uint32_t)n;
        }
        uint64_t n = size < r->filled - r->at ? size : r->filled - r->at;
        memcpy(to, r->buffer + r->at, (size_t)n);
        r->at += (uint32_t)n;
        to += n;
        size -= n;
    }
    return SVO_OK;
}

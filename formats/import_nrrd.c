/* NRRD, after teem's description: header, place, and the samples in the file or beside it. */
#include <bzlib.h>
#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <unistd.h>
#include <zlib.h>

#include "import_common.h"
#include "import_text.h"
#include "import_volume.h"

enum { LINE = 1024, PIECE = 1 << 16 };

typedef enum nrrd_encoding { ENCODING_NONE, ENCODING_RAW, ENCODING_GZIP, ENCODING_BZIP2, ENCODING_TEXT, ENCODING_HEX } nrrd_encoding;

typedef struct nrrd {
    volume_samples *s;
    nrrd_encoding encoding;
    bool has_type, has_sizes, has_directions;
    int dimension;
    double directions[9], origin[3];
    char file[LINE];   /* of the data; "": in this one */
    double skip_bytes, skip_lines; /* -1 bytes: the data are the last ones */
    uint64_t most; /* bytes that a temporary file may have, 0: no limit */
} nrrd;

/* The next line of the header, without its end; NULL when there is none, or it is too long. The last line of a header without data may have no end. */
static const char *next_line(const uint8_t *data, uint64_t size, uint64_t *at, char line[LINE])
{
    uint64_t end = *at;
    while (end < size && data[end] != '\n') end++;
    uint64_t n = end - *at;
    if ((end == size && n == 0) || n >= LINE) return NULL;
    memcpy(line, data + *at, n);
    if (n > 0 && line[n - 1] == '\r') n--;
    line[n] = 0;
    *at = end < size ? end + 1 : end;
    return line;
}

/* Words are told apart without regard to case, as teem does. */
static bool read_type(const char *t, nrrd *n)
{
    static const struct { const char *names[8]; volume_type type; } types[] = {
        {{"signed char", "int8", "int8_t"}, VOLUME_I8}, {{"uchar", "unsigned char", "uint8", "uint8_t"}, VOLUME_U8},
        {{"short", "short int", "signed short", "signed short int", "int16", "int16_t"}, VOLUME_I16}, {{"ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"}, VOLUME_U16},
        {{"int", "signed int", "int32", "int32_t"}, VOLUME_I32}, {{"uint", "unsigned int", "uint32", "uint32_t"}, VOLUME_U32},
        {{"longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"}, VOLUME_I64},
        {{"ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"}, VOLUME_U64}, {{"float"}, VOLUME_F32}, {{"double"}, VOLUME_F64}};
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        for (int k = 0; k < 8 && types[i].names[k] != NULL; k++)
            if (strcasecmp(types[i].names[k], t) == 0) {
                n->s->type = types[i].type;
                return true;
            }
    return false;
}

static bool read_sizes(const char *value, nrrd *n)
{
    double v[4];
    int count = import_numbers(value, v, 4);
    if (n->dimension == 0 || count != n->dimension) return false;
    n->has_sizes = volume_sizes(v + (count == 4), n->s->size);
    return n->has_sizes && (count == 3 || v[0] == 4);
}

static bool read_spacings(const char *value, nrrd *n)
{
    const double *at = n->directions;
    double v[4] = {0};
    int read = 0, count = 0;
    (void)at;
    for (const char *p = value; *p != 0 && count < 4; count++) { /* "nan" stands for an axis without a place */
        p += strspn(p, " \t");
        size_t length = strcspn(p, " \t");
        if (length == 0) break;
        const bool none = length == 3 && (memcmp(p, "nan", 3) == 0 || memcmp(p, "NaN", 3) == 0);
        if (!none && (!import_number_slow(p, p + length, false, &v[count]) || !isfinite(v[count]))) return false;
        read = count + 1;
        p += length;
    }
    if (read != 3 && read != 4) return false;
    for (int k = 0; k < 3; k++) n->directions[4 * k] = v[k + read - 3];
    n->has_directions = true;
    return true;
}

static svo_result read_encoding(const char *value, nrrd *n, svo_error *err)
{
    n->encoding = strcasecmp(value, "raw") == 0 ? ENCODING_RAW
                  : strcasecmp(value, "gzip") == 0 || strcasecmp(value, "gz") == 0 ? ENCODING_GZIP
                  : strcasecmp(value, "bzip2") == 0 || strcasecmp(value, "bz2") == 0 ? ENCODING_BZIP2
                  : strcasecmp(value, "hex") == 0 ? ENCODING_HEX
                  : strcasecmp(value, "ascii") == 0 || strcasecmp(value, "text") == 0 || strcasecmp(value, "txt") == 0 ? ENCODING_TEXT : ENCODING_NONE;
    return n->encoding != ENCODING_NONE ? SVO_OK : svo_fail(err, SVO_UNSUPPORTED, "NRRD encoding \"%.40s\"; raw, gzip, bzip2, hex and ascii are read (unu save -e gzip makes one)", value);
}

static svo_result read_field(const char *line, nrrd *n, svo_error *err)
{
    const char *colon = strstr(line, ": ");
    if (line[0] == '#' || strstr(line, ":=") != NULL) return SVO_OK;
    if (colon == NULL) return svo_fail(err, SVO_INVALID_DATA, "NRRD header: \"%.60s\" is no field", line);
    const char *value = colon + 2 + strspn(colon + 2, " \t");
    const size_t key = (size_t)(colon - line);
#define IS(word) (key == strlen(word) && memcmp(line, word, key) == 0)
    bool good = true;
    double v[9];
    if (IS("type")) {
        good = n->has_type = read_type(value, n);
    } else if (IS("dimension")) {
        good = import_numbers(value, v, 1) == 1 && (v[0] == 3 || v[0] == 4);
        n->dimension = good ? (int)v[0] : 0;
    } else if (IS("sizes")) {
        good = read_sizes(value, n);
    } else if (IS("endian")) {
        n->s->big = strcasecmp(value, "big") == 0;
        good = n->s->big || strcasecmp(value, "little") == 0;
    } else if (IS("encoding")) {
        return read_encoding(value, n, err);
    } else if (IS("space directions")) {
        const char *vectors = strncmp(value, "none ", 5) == 0 ? value + 5 : value;
        good = n->has_directions = import_numbers(vectors, n->directions, 9) == 9;
    } else if (IS("spacings") && !n->has_directions) {
        good = read_spacings(value, n);
    } else if (IS("space origin")) {
        good = import_numbers(value, n->origin, 3) == 3;
    } else if (IS("data file") || IS("datafile")) {
        if (strncmp(value, "LIST", 4) == 0 || strchr(value, '%') != NULL) return svo_fail(err, SVO_UNSUPPORTED, "NRRD data in several files are not read");
        good = value[0] != 0;
        snprintf(n->file, sizeof n->file, "%s", value);
    } else if (IS("byte skip") || IS("byteskip")) {
        good = import_numbers(value, &n->skip_bytes, 1) == 1 && n->skip_bytes >= -1 && n->skip_bytes == floor(n->skip_bytes) && n->skip_bytes < 1e15;
    } else if (IS("line skip") || IS("lineskip")) {
        good = import_numbers(value, &n->skip_lines, 1) == 1 && n->skip_lines >= 0 && n->skip_lines == floor(n->skip_lines) && n->skip_lines < 1e15;
    }
#undef IS
    return good ? SVO_OK : svo_fail(err, SVO_INVALID_DATA, "NRRD header: \"%.80s\" is wrong, or not a volume of 3 axes (4 with red, green, blue, alpha first)", line);
}

static void place(nrrd *n)
{
    const double *d = n->directions; /* d[3 axis + row] */
    double *m = n->s->to_world;
    memset(m, 0, sizeof n->s->to_world);
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++) m[4 * r + k] = d[3 * k + r];
        m[4 * r + 3] = n->origin[r] - 0.5 * (d[r] + d[3 + r] + d[6 + r]); /* samples are cell centres */
    }
    m[15] = 1;
}

/* --- samples --- */

/* An unnamed file of exactly `bytes`, filled by what follows. */
typedef struct filler {
    int fd;
    uint64_t left;
    uint64_t skip; /* of what comes first */
    svo_error *err;
} filler;

static svo_result put(filler *f, const uint8_t *p, uint64_t n)
{
    const uint64_t drop = n < f->skip ? n : f->skip;
    f->skip -= drop;
    p += drop;
    n -= drop;
    if (n > f->left) n = f->left;
    f->left -= n;
    while (n != 0) {
        ssize_t done = write(f->fd, p, n);
        if (done <= 0) return svo_fail(f->err, SVO_IO, "cannot write a temporary file (TMPDIR); is the disk full?");
        p += done;
        n -= (uint64_t)done;
    }
    return SVO_OK;
}

/* What decoders, which count in 32 bits, take at a time. */
static uint32_t next_piece(const uint8_t **p, uint64_t *size)
{
    const uint32_t n = *size < (1u << 30) ? (uint32_t)*size : 1u << 30;
    *p += n, *size -= n;
    return n;
}

static svo_result inflate_all(const uint8_t *p, uint64_t size, filler *f)
{
    uint8_t *out = malloc(PIECE);
    z_stream z = {0};
    if (out == NULL || inflateInit2(&z, 15 + 32) != Z_OK) { /* gzip or zlib */
        free(out);
        return svo_fail(f->err, SVO_OUT_OF_MEMORY, "no memory to decode gzip");
    }
    svo_result r = SVO_OK;
    int code = Z_OK;
    while (r == SVO_OK && f->left != 0 && code == Z_OK) {
        if (z.avail_in == 0) {
            z.next_in = (Bytef *)(uintptr_t)p;
            z.avail_in = next_piece(&p, &size);
        }
        z.next_out = out;
        z.avail_out = PIECE;
        code = inflate(&z, Z_NO_FLUSH);
        if (code == Z_OK || code == Z_STREAM_END) r = put(f, out, PIECE - z.avail_out);
        if (code == Z_STREAM_END && f->left != 0 && (z.avail_in != 0 || size != 0)) code = inflateReset(&z); /* gzip files may be joined */
    }
    inflateEnd(&z);
    free(out);
    if (r == SVO_OK && f->left != 0)
        r = svo_fail(f->err, SVO_INVALID_DATA, code == Z_STREAM_END || code == Z_BUF_ERROR ? "the compressed samples end %llu bytes too early" : "the gzip data are damaged, %llu bytes before their end",
                     (unsigned long long)f->left);
    return r;
}

/* Files may be joined. */
static svo_result unpack_bzip2(const uint8_t *p, uint64_t size, filler *f)
{
    char *out = malloc(PIECE);
    bz_stream z = {0};
    if (out == NULL || BZ2_bzDecompressInit(&z, 0, 0) != BZ_OK) {
        free(out);
        return svo_fail(f->err, SVO_OUT_OF_MEMORY, "no memory to decode bzip2");
    }
    svo_result r = SVO_OK;
    int code = BZ_OK;
    bool ends = false;
    while (r == SVO_OK && f->left != 0 && code == BZ_OK && !ends) {
        if (z.avail_in == 0) {
            z.next_in = (char *)(uintptr_t)p;
            z.avail_in = next_piece(&p, &size);
        }
        z.next_out = out;
        z.avail_out = PIECE;
        const bool all = z.avail_in == 0;
        code = BZ2_bzDecompress(&z);
        if (code == BZ_OK || code == BZ_STREAM_END) r = put(f, (const uint8_t *)out, PIECE - z.avail_out);
        ends = all && z.avail_out == PIECE; /* nothing came of nothing */
        if (code == BZ_STREAM_END && f->left != 0 && (z.avail_in != 0 || size != 0)) {
            char *rest = z.next_in;
            const unsigned left = z.avail_in;
            BZ2_bzDecompressEnd(&z);
            z = (bz_stream){0};
            code = BZ2_bzDecompressInit(&z, 0, 0);
            z.next_in = rest, z.avail_in = left;
        }
    }
    BZ2_bzDecompressEnd(&z);
    free(out);
    if (r == SVO_OK && f->left != 0)
        r = svo_fail(f->err, SVO_INVALID_DATA, ends || code == BZ_STREAM_END ? "the compressed samples end %llu bytes too early" : "the bzip2 data are damaged, %llu bytes before their end",
                     (unsigned long long)f->left);
    return r;
}

/* Two digits a byte, with space between any of them. */
static svo_result read_hex(const uint8_t *p, uint64_t size, filler *f)
{
    uint8_t buffer[PIECE];
    uint32_t used = 0, digits = 0, value = 0;
    for (uint64_t i = 0; i < size && f->left > used; i++) {
        if (import_space((char)p[i])) continue;
        if (!isxdigit(p[i])) return svo_fail(f->err, SVO_INVALID_DATA, "byte %llu of the NRRD's hexadecimal samples is no digit", (unsigned long long)i);
        value = value << 4 | (uint32_t)(p[i] <= '9' ? p[i] - '0' : (p[i] | 32) - 'a' + 10);
        if (++digits % 2 != 0) continue;
        buffer[used++] = (uint8_t)value;
        if (used < PIECE) continue;
        SVO_TRY(put(f, buffer, used));
        used = 0;
    }
    SVO_TRY(put(f, buffer, used));
    return f->left == 0 ? SVO_OK : svo_fail(f->err, SVO_INVALID_DATA, "the NRRD's hexadecimal samples end %llu bytes too early", (unsigned long long)f->left);
}

static void store(const nrrd *n, double v, uint8_t out[8])
{
    const uint32_t bytes = volume_type_size(n->s->type);
    uint64_t u = 0;
    if (n->s->type == VOLUME_F64) {
        memcpy(&u, &v, 8);
    } else if (n->s->type == VOLUME_F32) {
        float f = (float)v;
        memcpy(&u, &f, 4);
    } else {
        u = (uint64_t)(int64_t)v;
    }
    for (uint32_t i = 0; i < bytes; i++) out[n->s->big ? bytes - 1 - i : i] = (uint8_t)(u >> 8 * i);
}

static svo_result read_text(const nrrd *n, const uint8_t *p, uint64_t size, uint64_t count, filler *f)
{
    const char *q = (const char *)p, *end = q + size;
    const bool floats = n->s->type == VOLUME_F32 || n->s->type == VOLUME_F64;
    uint8_t buffer[PIECE];
    uint32_t used = 0, bytes = volume_type_size(n->s->type);
    for (uint64_t i = 0; i < count; i++) {
        double v;
        while (q < end && (import_space(*q) || *q == ',')) q++;
        const char *stop = q;
        while (stop < end && !import_space(*stop) && *stop != ',') stop++;
        if (q == stop || import_double(q, stop, &v) != stop || (!floats && !(fabs(v) < 9.2e18)))
            return svo_fail(f->err, SVO_INVALID_DATA, "sample %llu of the NRRD text is no number of its type, or the text ends", (unsigned long long)i);
        q = stop;
        store(n, v, buffer + used);
        used += bytes;
        if (used + 8 > PIECE || i + 1 == count) {
            SVO_TRY(put(f, buffer, used));
            used = 0;
        }
    }
    return SVO_OK;
}

/* Bytes are skipped after they are unpacked. */
static bool is_packed(const nrrd *n) { return n->encoding == ENCODING_GZIP || n->encoding == ENCODING_BZIP2; }

static svo_result decode(const nrrd *n, const uint8_t *p, uint64_t size, uint64_t bytes, svo_error *err)
{
    filler f = {.fd = -1, .left = bytes, .err = err};
    const uint64_t count = bytes / volume_type_size(n->s->type);
    /* deflate makes at most 1032 bytes of one, bzip2 a block of 900000 runs of 5 to 255 equal ones from some 30 bytes; a number takes two characters, as a byte in hexadecimal */
    const bool enough = n->encoding == ENCODING_GZIP ? bytes / 1032 <= size : n->encoding == ENCODING_BZIP2 ? bytes / 2000000 <= size : n->encoding == ENCODING_HEX ? bytes <= size / 2 : count <= size / 2 + 1;
    if (!enough)
        return svo_fail(err, SVO_INVALID_DATA, "%llu bytes of samples cannot come from %llu", (unsigned long long)bytes, (unsigned long long)size);
    if (n->most != 0 && bytes > n->most)
        return svo_fail(err, SVO_LIMIT, "the samples are %llu bytes when they are unpacked to a temporary file, and %llu are allowed (--temp-size)", (unsigned long long)bytes, (unsigned long long)n->most);
    if (is_packed(n)) f.skip = (uint64_t)n->skip_bytes;
    SVO_TRY(fmt_scratch_file(&f.fd, err));
    svo_result r = n->encoding == ENCODING_GZIP ? inflate_all(p, size, &f)
                   : n->encoding == ENCODING_BZIP2 ? unpack_bzip2(p, size, &f)
                   : n->encoding == ENCODING_HEX ? read_hex(p, size, &f) : read_text(n, p, size, count, &f);
    if (r == SVO_OK) {
        void *m = mmap(NULL, (size_t)bytes, PROT_READ, MAP_PRIVATE, f.fd, 0);
        if (m == MAP_FAILED) r = svo_fail(err, SVO_IO, "cannot map the decoded samples");
        else n->s->data = n->s->mapped = m, n->s->mapped_size = bytes;
    }
    close(f.fd);
    return r;
}

static svo_result find_samples(const nrrd *n, const uint8_t *p, uint64_t size, svo_error *err)
{
    volume_samples *s = n->s;
    const uint64_t total = s->size[0] * s->size[1] * s->size[2], width = volume_type_size(s->type);
    if (total > UINT64_MAX / 16) return svo_fail(err, SVO_INVALID_DATA, "%llu x %llu x %llu samples are in no file", (unsigned long long)s->size[0], (unsigned long long)s->size[1], (unsigned long long)s->size[2]);
    for (uint64_t k = 0; k < (uint64_t)n->skip_lines; k++) {
        const uint8_t *stop = size != 0 ? memchr(p, '\n', (size_t)size) : NULL;
        if (stop == NULL) return svo_fail(err, SVO_INVALID_DATA, "there are fewer lines than \"line skip\" says");
        size -= (uint64_t)(stop + 1 - p);
        p = stop + 1;
    }
    if (n->skip_bytes < 0 && n->encoding != ENCODING_RAW) return svo_fail(err, SVO_UNSUPPORTED, "NRRD \"byte skip: -1\" is for raw samples");
    if (!is_packed(n) && n->skip_bytes > 0) {
        if (n->skip_bytes > (double)size) return svo_fail(err, SVO_INVALID_DATA, "there are fewer bytes than \"byte skip\" says");
        p += (uint64_t)n->skip_bytes;
        size -= (uint64_t)n->skip_bytes;
    }
    if (n->encoding != ENCODING_RAW) return decode(n, p, size, total * width, err);
    if (total > size / width || (n->skip_bytes >= 0 && n->file[0] == 0 && size != total * width))
        return svo_fail(err, SVO_INVALID_DATA, "%llu x %llu x %llu samples of %llu bytes are not the %llu bytes that are there", (unsigned long long)s->size[0], (unsigned long long)s->size[1],
                        (unsigned long long)s->size[2], (unsigned long long)width, (unsigned long long)size);
    s->data = n->skip_bytes < 0 ? p + (size - total * width) : p;
    return SVO_OK;
}

static svo_result open_beside(const char *path, const nrrd *n, const fmt_volume_options *o, svo_error *err)
{
    import_context c = {.path = path, .allocator = o->allocator, .file_read = o->file_read, .file_read_user = o->file_read_user, .max_file_bytes = 1};
    const char *slash = strrchr(path, '/');
    const size_t length = slash != NULL ? (size_t)(slash - path) + 1 : 0;
    char name[IMPORT_PATH_MAX];
    if (length >= sizeof c.folder) return svo_fail(err, SVO_INVALID_ARGUMENT, "%.100s...: the path is too long", path);
    memcpy(c.folder, path, length);
    SVO_TRY(import_resolve(&c, n->file, name, err));
    SVO_TRY(import_open(&c, name, &n->s->file, err));
    return SVO_OK;
}

void volume_samples_free(volume_samples *s)
{
    if (s->mapped != NULL) munmap(s->mapped, (size_t)s->mapped_size);
    fmt_bytes_close(&s->file);
    s->mapped = NULL;
    s->data = NULL;
}

svo_result import_nrrd(const char *path, const uint8_t *bytes, uint64_t size, const fmt_volume_options *o, volume_samples *out, svo_error *err)
{
    nrrd n = {.s = out, .most = o->temporary, .directions = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    char line[LINE];
    uint64_t at = 0;
    next_line(bytes, size, &at, line); /* NRRD000x */
    while (at < size) {
        if (next_line(bytes, size, &at, line) == NULL) return svo_fail(err, SVO_INVALID_DATA, "the NRRD header has a line that is too long");
        if (line[0] == 0) break;
        SVO_TRY(read_field(line, &n, err));
    }
    if (!n.has_type || !n.has_sizes || n.encoding == ENCODING_NONE) return svo_fail(err, SVO_INVALID_DATA, "the NRRD header has no type, sizes or encoding");
    if (n.dimension == 4) {
        if (out->type != VOLUME_U8) return svo_fail(err, SVO_UNSUPPORTED, "NRRD with 4 axes: only red, green, blue, alpha of type uint8 are read");
        if (n.encoding == ENCODING_TEXT) return svo_fail(err, SVO_UNSUPPORTED, "NRRD colours as text are not read");
        out->type = VOLUME_RGBA;
    }
    place(&n);
    svo_result r = SVO_OK;
    if (n.file[0] != 0) {
        r = open_beside(path, &n, o, err);
        if (r == SVO_OK) r = find_samples(&n, out->file.data, out->file.size, err);
    } else {
        r = find_samples(&n, bytes + at, size - at, err);
    }
    if (r == SVO_OK && n.encoding == ENCODING_RAW) return r;
    if (r == SVO_OK) fmt_bytes_close(&out->file); /* decoded: no longer needed */
    else volume_samples_free(out);
    if (r == SVO_OK) memset(&out->file, 0, sizeof out->file);
    return r;
}

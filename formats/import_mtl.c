/* MTL, the material libraries of OBJ. How its terms map to metallic-roughness is written in docs/tools/formats.md. */
#include "import_obj.h"

#include <math.h>
#include <string.h>

#include "import_text.h"

void mtl_init(mtl_set *set, const import_context *c)
{
    svo_buffer_init(&set->list, c->allocator);
    import_images_init(&set->images, c);
}

void mtl_free(mtl_set *set)
{
    svo_material *m = (svo_material *)(void *)set->list.data;
    for (uint64_t i = 0; i < set->list.size / sizeof *m; i++) svo_string_free(set->list.allocator, m[i].name);
    svo_buffer_free(&set->list);
    import_images_free(&set->images);
}

typedef struct mtl_parser {
    mtl_set *set;
    const import_context *context;
    svo_material *m; /* current, in the list's last place; NULL before newmtl */
    bool has_d, has_kd, has_pr;
} mtl_parser;

/* One value or three; "spectral" and "xyz" forms are not read. */
static bool read_rgb(const char *p, const char *end, double rgb[3])
{
    for (int k = 0; k < 3; k++) {
        p = import_skip_blank(p, end);
        if (p == end && k == 1) {
            rgb[1] = rgb[2] = rgb[0];
            return true;
        }
        p = p < end ? import_double(p, end, &rgb[k]) : NULL;
        if (p == NULL) return false;
    }
    return true;
}

static bool read_one(const char *p, const char *end, double *v)
{
    p = import_skip_blank(p, end);
    return p < end && import_double(p, end, v) != NULL;
}

static double unit(double v) { return v > 1 ? 1 : v >= 0 ? v : 0; }

/* --- texture lines: options, then a file name that may hold blanks --- */

typedef struct map_options {
    double scale[2], offset[2];
    bool clamp;
} map_options;

/* Numbers after an option: at least one, at most max. */
static const char *option_numbers(const char *p, const char *end, double *v, int max, int *count)
{
    *count = 0;
    while (*count < max) {
        const char *q = import_skip_blank(p, end);
        double x;
        const char *after = q < end ? import_double(q, end, &x) : NULL;
        /* The last token of a line is the file, even if it looks like a number. */
        if (after == NULL || import_skip_blank(after, end) == end) break;
        v[(*count)++] = x;
        p = after;
    }
    return p;
}

static const char *read_options(const mtl_parser *t, const char *p, const char *end, map_options *o)
{
    static const char *const words[] = {"-blendu", "-blendv", "-cc", "-type", "-imfchan", "-colorspace"}; /* one word follows */
    static const char *const ignored[] = {"-boost", "-mm", "-bm", "-texres", "-t"};                       /* numbers follow */
    *o = (map_options){{1, 1}, {0, 0}, false};
    for (;;) {
        p = import_skip_blank(p, end);
        if (p == end || *p != '-') return p;
        const char *q;
        double v[3];
        int n;
        if ((q = import_word(p, end, "-s")) != NULL) {
            p = option_numbers(q, end, v, 3, &n);
            if (n > 0) o->scale[0] = v[0], o->scale[1] = n > 1 ? v[1] : 1;
            continue;
        }
        if ((q = import_word(p, end, "-o")) != NULL) {
            p = option_numbers(q, end, v, 3, &n);
            if (n > 0) o->offset[0] = v[0], o->offset[1] = n > 1 ? v[1] : 0;
            continue;
        }
        if ((q = import_word(p, end, "-clamp")) != NULL) {
            q = import_skip_blank(q, end);
            o->clamp = import_word_nocase(q, end, "on") != NULL;
            p = import_token_end(q, end);
            continue;
        }
        bool known = false;
        for (size_t i = 0; i < sizeof words / sizeof *words && !known; i++)
            if ((q = import_word(p, end, words[i])) != NULL) {
                p = import_token_end(import_skip_blank(q, end), end);
                known = true;
            }
        for (size_t i = 0; i < sizeof ignored / sizeof *ignored && !known; i++)
            if ((q = import_word(p, end, ignored[i])) != NULL) {
                p = option_numbers(q, end, v, 3, &n);
                svo_warn(t->context->warnings, "%s: texture option '%s' is ignored", t->context->path, ignored[i]);
                known = true;
            }
        if (!known) return p; /* a file name that begins with '-' */
    }
}

/* What a map's line says. False where it names nothing. */
static bool map_name(const mtl_parser *t, const char *p, const char *end, map_options *o, char name[IMPORT_PATH_MAX])
{
    p = read_options(t, p, end, o);
    while (end > p && import_space(end[-1])) end--;
    if (end - p >= 2 && *p == '"' && end[-1] == '"') p++, end--;
    size_t n = (size_t)(end - p);
    if (n == 0 || n >= IMPORT_PATH_MAX || memchr(p, '\0', n) != NULL) return false;
    memcpy(name, p, n);
    name[n] = '\0';
    return true;
}

typedef enum map_kind { MAP_NONE, MAP_COLOR, MAP_EMISSIVE, MAP_OPACITY } map_kind;

/* Is it the line of a map that is wanted? *p goes behind the word, and to the end where nobody reads the map. */
static map_kind map_line(const mtl_parser *t, const char **p, const char *end)
{
    static const struct { const char *word; map_kind kind; } words[] = {{"map_Kd", MAP_COLOR}, {"map_Ke", MAP_EMISSIVE}, {"map_d", MAP_OPACITY}, {"map_opacity", MAP_OPACITY}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        const char *q = import_word_nocase(*p, end, words[i].word);
        if (q == NULL) continue;
        *p = words[i].kind == MAP_EMISSIVE && (t->context->without & FMT_WITHOUT_EMISSIVE) != 0 ? end : q;
        return words[i].kind;
    }
    return MAP_NONE;
}

/* Without colours, what cuts is all that matters. */
static bool alpha_only(const mtl_parser *t, map_kind kind) { return kind == MAP_COLOR && (t->context->without & FMT_WITHOUT_COLOR) != 0; }

static svo_result read_map(mtl_parser *t, map_kind kind, const char *p, const char *end, svo_error *err)
{
    map_options o;
    char name[IMPORT_PATH_MAX];
    svo_texture texture = svo_texture_none();
    svo_texture *to = kind == MAP_COLOR ? &t->m->base_color_texture : kind == MAP_EMISSIVE ? &t->m->emissive_texture : &t->m->opacity_texture;
    if (!map_name(t, p, end, &o, name)) return SVO_OK;
    SVO_TRY(import_image_find(&t->set->images, t->context, name, alpha_only(t, kind), &texture.image, err));
    if (texture.image == SVO_NONE) return SVO_OK;
    texture.wrap_u = texture.wrap_v = o.clamp ? SVO_WRAP_CLAMP : SVO_WRAP_REPEAT;
    /* MTL scales and shifts with v upwards: v' = s (1 - v) + o there is 1 - s + s v - o here. */
    double transform[6] = {o.scale[0], 0, o.offset[0], 0, o.scale[1], 1 - o.scale[1] - o.offset[1]};
    memcpy(texture.transform, transform, sizeof transform);
    *to = texture;
    return SVO_OK;
}

static svo_image *image_of(mtl_parser *t, uint32_t index)
{
    return (svo_image *)(void *)t->set->images.list.data + index;
}

/* Scalar maps are read from the red channel; where the image carries its values in alpha (and it is not the colour
 * image, whose alpha counts anyway), a copy with alpha in all channels is made. */
static svo_result opacity_image(mtl_parser *t, svo_texture *opacity, svo_error *err)
{
    const svo_allocator *a = t->context->allocator;
    svo_pager *pager = t->context->pager;
    const svo_image *from = image_of(t, opacity->image);
    if (!from->has_alpha) return SVO_OK;
    uint64_t pixels = (uint64_t)from->width * from->height;
    svo_image copy = {.width = from->width, .height = from->height};
    if (pager != NULL && from->paged != NULL) {
        SVO_TRY(svo_paged_create(pager, 4 * pixels, &copy.paged, err));
        copy.pixels = copy.paged->data;
    } else {
        copy.pixels = svo_alloc(a, pixels, 4);
    }
    copy.name = svo_string_copy(a, from->name);
    if (copy.name == NULL || copy.pixels == NULL) {
        svo_string_free(a, copy.name);
        svo_image_free_pixels(a, &copy);
        return import_no_memory(err);
    }
    for (uint32_t y = 0; y < copy.height; y++) {
        svo_image_touch(from, 0, y, copy.width);
        svo_image_touch(&copy, 0, y, copy.width);
        const uint64_t row = (uint64_t)y * copy.width;
        for (uint64_t i = row; i < row + copy.width; i++) {
            memset(copy.pixels + 4 * i, from->pixels[4 * i + 3], 3);
            copy.pixels[4 * i + 3] = 255;
        }
    }
    if (svo_buffer_append(&t->set->images.list, &copy, sizeof copy) == NULL) {
        svo_string_free(a, copy.name);
        svo_image_free_pixels(a, &copy);
        return import_no_memory(err);
    }
    opacity->image = (uint32_t)(t->set->images.list.size / sizeof copy - 1);
    return SVO_OK;
}

/* What depends on several lines of a material. */
static svo_result finish_material(mtl_parser *t, svo_error *err)
{
    svo_material *m = t->m;
    if (m == NULL) return SVO_OK;
    svo_texture *opacity = &m->opacity_texture, *base = &m->base_color_texture;
    if (opacity->image != SVO_NONE && opacity->image == base->image && image_of(t, base->image)->has_alpha)
        *opacity = svo_texture_none(); /* the colour image's own alpha is meant */
    if (opacity->image != SVO_NONE) SVO_TRY(opacity_image(t, opacity, err));
    bool cut = opacity->image != SVO_NONE || (base->image != SVO_NONE && image_of(t, base->image)->has_alpha);
    if (cut) m->alpha_mode = SVO_ALPHA_MASK;
    else if (m->base_color[3] < 1) m->alpha_mode = SVO_ALPHA_BLEND;
    if (m->emissive_texture.image != SVO_NONE && m->emissive[0] == 0 && m->emissive[1] == 0 && m->emissive[2] == 0)
        m->emissive[0] = m->emissive[1] = m->emissive[2] = 1;
    return SVO_OK;
}

static svo_result new_material(mtl_parser *t, const char *p, const char *end, svo_error *err)
{
    SVO_TRY(finish_material(t, err));
    t->m = NULL;
    while (end > p && import_space(end[-1])) end--;
    svo_material m = svo_material_default();
    m.double_sided = true; /* OBJ renderers do not cull */
    size_t n = (size_t)(end - p);
    if (memchr(p, '\0', n) != NULL) n = strlen(p);
    m.name = svo_alloc(t->context->allocator, n + 1, 1);
    if (m.name == NULL) return import_no_memory(err);
    memcpy(m.name, p, n);
    m.name[n] = '\0';
    if (t->set->list.size / sizeof m >= 1u << 20) {
        svo_string_free(t->context->allocator, m.name);
        return svo_fail(err, SVO_LIMIT, "%s: more than 2^20 materials", t->context->path);
    }
    if (svo_buffer_append(&t->set->list, &m, sizeof m) == NULL) {
        svo_string_free(t->context->allocator, m.name);
        return import_no_memory(err);
    }
    t->m = (svo_material *)(void *)(t->set->list.data + t->set->list.size) - 1;
    t->has_d = t->has_kd = t->has_pr = false;
    return SVO_OK;
}

static bool color_line(mtl_parser *t, const char *p, const char *end, const char *word, bool encoded, float out[3])
{
    double rgb[3];
    if (!read_rgb(p, end, rgb)) {
        svo_warn(t->context->warnings, "%s: '%s' of material '%.60s' is not three numbers; ignored", t->context->path, word, t->m->name);
        return false;
    }
    /* Emission may exceed 1, where a transfer function has no meaning: the excess is a linear factor. */
    for (int k = 0; k < 3; k++) {
        double v = rgb[k] >= 0 ? rgb[k] : 0;
        out[k] = encoded && v <= 1 ? import_srgb_to_linear(v) : (float)v;
    }
    return true;
}

static svo_result read_term(mtl_parser *t, const char *p, const char *end, svo_error *err)
{
    const char *q;
    double v;
    svo_material *m = t->m;
    if ((q = import_word_nocase(p, end, "newmtl")) != NULL) return new_material(t, import_skip_blank(q, end), end, err);
    if (m == NULL) return SVO_OK;
    if ((q = import_word(p, end, "Kd")) != NULL) {
        float rgb[3];
        if (color_line(t, q, end, "Kd", true, rgb))
            for (int k = 0; k < 3; k++) m->base_color[k] = rgb[k] > 1 ? 1 : rgb[k];
        return SVO_OK;
    }
    if ((q = import_word(p, end, "Ke")) != NULL) {
        float rgb[3];
        if (color_line(t, q, end, "Ke", true, rgb)) memcpy(m->emissive, rgb, sizeof rgb);
        return SVO_OK;
    }
    if ((q = import_word(p, end, "d")) != NULL) {
        q = import_skip_blank(q, end);
        const char *halo = import_word(q, end, "-halo");
        if (read_one(halo != NULL ? halo : q, end, &v)) m->base_color[3] = (float)unit(v), t->has_d = true;
        return SVO_OK;
    }
    if ((q = import_word(p, end, "Tr")) != NULL) {
        if (!t->has_d && read_one(q, end, &v)) m->base_color[3] = (float)(1 - unit(v));
        return SVO_OK;
    }
    if ((q = import_word(p, end, "Pm")) != NULL) {
        if (read_one(q, end, &v)) m->metallic = (float)unit(v);
        return SVO_OK;
    }
    if ((q = import_word(p, end, "Pr")) != NULL) {
        if (read_one(q, end, &v)) m->roughness = (float)unit(v), t->has_pr = true;
        return SVO_OK;
    }
    if ((q = import_word(p, end, "Ns")) != NULL) {
        /* Blinn-Phong exponent to microfacet roughness: alpha^2 = 2 / (n + 2), alpha = roughness^2. */
        if (!t->has_pr && read_one(q, end, &v) && v >= 0) m->roughness = (float)pow(2 / (v + 2), 0.25);
        return SVO_OK;
    }
    const map_kind kind = map_line(t, &p, end);
    if (kind != MAP_NONE) return read_map(t, kind, p, end, err);
    static const char *const ignored[] = {"map_Ks", "map_Ns", "map_Pr", "map_Pm", "map_Tr", "map_Bump", "bump", "disp", "decal", "refl", "norm"};
    for (size_t i = 0; i < sizeof ignored / sizeof *ignored; i++)
        if (import_word_nocase(p, end, ignored[i]) != NULL)
            svo_warn(t->context->warnings, "%s: '%s' textures are ignored", t->context->path, ignored[i]);
    return SVO_OK;
}

/* All images at a time, before the lines that name them are looked at one by one. */
static svo_result read_images(const mtl_parser *of, const char *p, const char *end, svo_error *err)
{
    const svo_allocator *a = of->context->allocator;
    import_context quiet = *of->context; /* options are told later */
    quiet.warnings = NULL;
    const mtl_parser t = {.set = of->set, .context = &quiet};
    svo_buffer wishes;
    svo_buffer_init(&wishes, a);
    svo_result r = SVO_OK;
    for (bool in_material = false; p < end && r == SVO_OK;) {
        const char *stop = import_line_end(p, end), *q = import_skip_blank(p, stop);
        in_material |= import_word_nocase(q, stop, "newmtl") != NULL;
        const map_kind kind = in_material ? map_line(&t, &q, stop) : MAP_NONE;
        map_options o;
        char name[IMPORT_PATH_MAX];
        if (kind != MAP_NONE && map_name(&t, q, stop, &o, name)) {
            const import_wish wish = {svo_string_copy(a, name), alpha_only(&t, kind)};
            if (wish.reference == NULL || svo_buffer_append(&wishes, &wish, sizeof wish) == NULL) r = import_no_memory(err);
            if (r != SVO_OK && wish.reference != NULL) svo_string_free(a, (char *)(uintptr_t)wish.reference);
        }
        p = stop < end ? stop + 1 : end;
    }
    const import_wish *w = (const import_wish *)(const void *)wishes.data;
    const uint64_t count = wishes.size / sizeof *w;
    if (r == SVO_OK) r = import_images_read(&of->set->images, of->context, w, count, err);
    for (uint64_t i = 0; i < count; i++) svo_string_free(a, (char *)(uintptr_t)w[i].reference);
    svo_buffer_free(&wishes);
    return r;
}

svo_result mtl_read(mtl_set *set, const import_context *c, const uint8_t *bytes, uint64_t size, svo_error *err)
{
    if (size == 0) return SVO_OK; /* bytes may be NULL */
    mtl_parser t = {.set = set, .context = c};
    const char *p = (const char *)bytes, *end = p + size;
    if (size >= 3 && memcmp(p, "\xef\xbb\xbf", 3) == 0) p += 3;
    if (c->pager == NULL) SVO_TRY(read_images(&t, p, end, err));
    while (p < end) {
        const char *stop = import_line_end(p, end);
        const char *q = import_skip_blank(p, stop);
        if (q < stop && *q != '#') SVO_TRY(read_term(&t, q, stop, err));
        p = stop < end ? stop + 1 : end;
    }
    return finish_material(&t, err);
}

/* Options that have a little language of their own and belong to several tools. */
#include "cli_quality.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_voxelize.h"

/* "lossless", BITS, or "<key>=X". */
static bool parse_quality(const char *text, const char *key, uint32_t min_bits, uint32_t max_bits, uint32_t *bits, double *bound)
{
    char *end;
    size_t n = strlen(key);
    *bits = 0, *bound = 0;
    if (strcmp(text, "lossless") == 0) return true;
    if (strncmp(text, key, n) == 0 && text[n] == '=') {
        const char *number = text + n + 1;
        *bound = strtod(number, &end);
        return end != number && *end == 0 && isfinite(*bound) && *bound > 0;
    }
    if (text[0] < '0' || text[0] > '9') return false;
    unsigned long v = strtoul(text, &end, 10);
    *bits = (uint32_t)v;
    return *end == 0 && v >= min_bits && v <= max_bits;
}

/* Bounds of colours: deltaE=X, mean=X, psnr=X, joined by commas. False when it is something else. */
static bool parse_color_goal(const char *text, svo_dag_options *o)
{
    double bound = 0, mean = 0, psnr = 0;
    for (const char *at = text;; at++) {
        double *to = strncmp(at, "deltaE=", 7) == 0 ? &bound : strncmp(at, "mean=", 5) == 0 ? &mean : strncmp(at, "psnr=", 5) == 0 ? &psnr : NULL;
        if (to == NULL || *to > 0) return false;
        const char *number = strchr(at, '=') + 1;
        char *end;
        *to = strtod(number, &end);
        if (end == number || !isfinite(*to) || !(*to > 0) || (*end != 0 && *end != ',')) return false;
        at = end;
        if (*at == 0) break;
    }
    if (mean > 0 && psnr > 0) return false;
    if (!(bound > 0)) bound = psnr > 0 ? 8 : mean > 0.75 ? 8 * mean : 6;
    o->color_delta_e = bound, o->color_mean = mean, o->color_psnr = psnr;
    return true;
}

int cli_take_quality(cli *c, const char *color, const char *normal, svo_dag_options *o)
{
    if (!parse_color_goal(color, o) && !parse_quality(color, "deltaE", 1, 16, &o->color_bits, &o->color_delta_e))
        return cli_usage(c, "--color takes lossless, a number of bits from 1 to 16, or deltaE=X, mean=X or psnr=X (deltaE with one of the others after a comma) with X above 0, not '%s'", color);
    if (!parse_quality(normal, "deg", 4, 32, &o->normal_bits, &o->normal_degrees) || o->normal_bits % 2 != 0)
        return cli_usage(c, "--normal takes lossless, an even number of bits from 4 to 32, or deg=X with X above 0, not '%s'", normal);
    return -1;
}

int cli_take_channels(cli *c, const char *list, uint32_t *channels)
{
    static const struct { const char *name; uint32_t bit; } names[] = {
        {"color", SVO_WANT_COLOR}, {"normal", SVO_WANT_NORMAL}, {"emissive", SVO_WANT_EMISSIVE},
        {"metallic", SVO_WANT_METALLIC}, {"roughness", SVO_WANT_ROUGHNESS}, {"material", SVO_WANT_MATERIAL},
        {"coverage", SVO_WANT_COVERAGE}};
    *channels = strcmp(list, "auto") == 0 ? SVO_WANT_AUTO : 0;
    if (*channels != 0 || strcmp(list, "none") == 0) return -1;
    for (const char *at = list;; at++) {
        size_t length = strcspn(at, ",");
        uint32_t bit = 0;
        for (size_t i = 0; i < sizeof names / sizeof *names; i++)
            if (strlen(names[i].name) == length && memcmp(names[i].name, at, length) == 0) bit = names[i].bit;
        if (bit == 0) return cli_usage(c, "--attributes: \"%.*s\" is no channel", length < 40 ? (int)length : 40, at);
        *channels |= bit;
        at += length;
        if (*at == 0) return -1;
    }
}

#include "svo_color.h"

#include <math.h>
#include <string.h>

#include "svo_channel.h"

/* Cube root of a positive normal double: an estimate from the exponent (error below 6 %), then Halley's iteration,
 * which triples the correct digits. Not cbrt(), whose last bits differ between C libraries. */
static double cube_root(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = bits / 3 + 0x2a9f7893782da1ceu;
    double y;
    memcpy(&y, &bits, sizeof y);
    for (int i = 0; i < 3; i++) {
        double c = y * y * y;
        y = y * (c + 2 * x) / (2 * c + x);
    }
    return y;
}

/* f of CIE 15: cube root, with a straight line near black. */
static double lab_f(double t)
{
    const double e = 216.0 / 24389.0, k = 24389.0 / 27.0;
    return t > e ? cube_root(t) : (k * t + 16) / 116;
}

void svo_srgb8_to_lab(const uint8_t rgb[3], float lab[3])
{
    double r = svo_srgb_to_linear(rgb[0]), g = svo_srgb_to_linear(rgb[1]), b = svo_srgb_to_linear(rgb[2]);
    /* The matrix of IEC 61966-2-1, each row divided by its sum, which is the white point. */
    double x = (0.4124 * r + 0.3576 * g + 0.1805 * b) / (0.4124 + 0.3576 + 0.1805);
    double y = (0.2126 * r + 0.7152 * g + 0.0722 * b) / (0.2126 + 0.7152 + 0.0722);
    double z = (0.0193 * r + 0.1192 * g + 0.9505 * b) / (0.0193 + 0.1192 + 0.9505);
    double fx = lab_f(x), fy = lab_f(y), fz = lab_f(z);
    lab[0] = (float)(116 * fy - 16);
    lab[1] = (float)(500 * (fx - fy));
    lab[2] = (float)(200 * (fy - fz));
}

double svo_delta_e94(const float reference[3], const float other[3])
{
    double a1 = reference[1], b1 = reference[2], a2 = other[1], b2 = other[2];
    double c1 = sqrt(a1 * a1 + b1 * b1), c2 = sqrt(a2 * a2 + b2 * b2);
    double dl = (double)reference[0] - other[0], dc = c1 - c2;
    double dh2 = (a1 - a2) * (a1 - a2) + (b1 - b2) * (b1 - b2) - dc * dc;
    if (dh2 < 0) dh2 = 0; /* rounding */
    double sc = 1 + 0.045 * c1, sh = 1 + 0.015 * c1;
    return sqrt(dl * dl + dc * dc / (sc * sc) + dh2 / (sh * sh));
}

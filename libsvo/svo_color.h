/* Colour differences as people see them: sRGB to CIELAB, and CIE94.
 *
 * CIELAB here is relative to D65, the white of sRGB itself (IEC 61966-2-1), without chromatic adaptation: white is
 * (100, 0, 0) and every grey has a = b = 0 to rounding. Nothing but IEEE arithmetic and square roots is used, so that
 * decisions made with these numbers are the same on every machine. */
#ifndef SVO_COLOR_H
#define SVO_COLOR_H

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* lab = L* (0..100), a*, b* of an sRGB-encoded colour. */
void svo_srgb8_to_lab(const uint8_t rgb[3], float lab[3]);

/* CIE94 with the graphic arts constants (kL = kC = kH = 1, K1 = 0.045, K2 = 0.015). NOT symmetric: the weights come
 * from the chroma of `reference`, which is the original; `other` is its approximation. */
double svo_delta_e94(const float reference[3], const float other[3]);

#ifdef __cplusplus
}
#endif
#endif

/* Colour difference, PSNR, SSIM and the comparison of octrees, against values worked out by hand or in the papers. */
#include <math.h>
#include <string.h>

#include "svo_color.h"
#include "test.h"

static bool near(double a, double b, double tolerance) { return fabs(a - b) <= tolerance; }

/* Published CIELAB (D65) values of the sRGB primaries, to four decimals with this matrix. */
TEST(lab_of_known_colours)
{
    static const struct { uint8_t rgb[3]; double lab[3]; } known[] = {
        {{255, 255, 255}, {100, 0, 0}},
        {{0, 0, 0}, {0, 0, 0}},
        {{255, 0, 0}, {53.2408, 80.0925, 67.2032}},
        {{0, 255, 0}, {87.7347, -86.1827, 83.1793}},
        {{0, 0, 255}, {32.2970, 79.1875, -107.8602}},
        {{119, 119, 119}, {50.0344, 0, 0}},
    };
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        float lab[3];
        svo_srgb8_to_lab(known[i].rgb, lab);
        for (int k = 0; k < 3; k++)
            CHECK_MSG(near(lab[k], known[i].lab[k], 0.02), "colour %zu component %d: %.5f, expected %.5f", i, k, lab[k], known[i].lab[k]);
    }
}

TEST(greys_have_no_chroma_and_rise)
{
    float before = -1;
    for (int v = 0; v < 256; v++) {
        uint8_t rgb[3] = {(uint8_t)v, (uint8_t)v, (uint8_t)v};
        float lab[3];
        svo_srgb8_to_lab(rgb, lab);
        CHECK(near(lab[1], 0, 1e-5) && near(lab[2], 0, 1e-5));
        CHECK(lab[0] > before);
        before = lab[0];
    }
}

TEST(delta_e94_by_hand)
{
    /* Only lightness differs. */
    CHECK(near(svo_delta_e94((float[]){50, 0, 0}, (float[]){53, 0, 0}), 3, 1e-9));
    /* Same hue: the reference's chroma 20 gives SC = 1.9, so 10 / 1.9; the other way round SC = 2.35. */
    CHECK(near(svo_delta_e94((float[]){50, 20, 0}, (float[]){50, 30, 0}), 10 / 1.9, 1e-9));
    CHECK(near(svo_delta_e94((float[]){50, 30, 0}, (float[]){50, 20, 0}), 10 / 2.35, 1e-9));
    /* Same chroma 20, hue turned by 90 degrees: dH^2 = 800, SH = 1.3. */
    CHECK(near(svo_delta_e94((float[]){50, 20, 0}, (float[]){50, 0, 20}), sqrt(800) / 1.3, 1e-9));
    /* All three at once: C 5 -> 13, SC = 1.225, SH = 1.075, da^2 + db^2 = 4 + 64 = 68, dC^2 = 64. */
    CHECK(near(svo_delta_e94((float[]){50, 3, 4}, (float[]){48, 5, 12}), sqrt(4 + 64 / (1.225 * 1.225) + 4 / (1.075 * 1.075)), 1e-9));
    CHECK(svo_delta_e94((float[]){12, 3, -4}, (float[]){12, 3, -4}) == 0);
}

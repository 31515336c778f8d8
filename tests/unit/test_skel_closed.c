/* What a skeleton of a closed model must be: a curve inside, as many loops as the genus, and one whose inscribed balls give the model back better than the curves of two
 * public tools do. */
#include "skel_models.h"
#include "test.h"

static svo_error err;

static void closed(const char *model, double omega, double error)
{
    shape s;
    if (!shape_of_model(model, &s)) {
        test_skip("no %s", model);
        return;
    }
    skel_options o = skel_default_options();
    if (omega > 0) o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    skel_skeleton a;
    CHECK_OK(shape_skeleton(&s, &o, &a, &err));
    const skel_quality *q = &a.report.quality;
    CHECK(q->genus_known);
    CHECK_U64(a.report.loops, q->genus);
    CHECK_U64(a.report.components, 1);
    CHECK_MSG(q->length_inside >= 99 && q->joints_inside >= 99, "%g %% of the curve, %g %% of the joints inside", q->length_inside, q->joints_inside);
    CHECK_MSG(q->balls_mean < error, "surface to the inscribed balls: %g %% of the diagonal, not below %g", q->balls_mean, error);
    skel_skeleton_free(&a);
    shape_free(&s);
}

/* Bounds: the better of CGAL 5.5's mean curvature flow (bench_skeleton --cgal, these very files) and GEL's local separators (published for decimated models, in percent of the
 * longest side). */
TEST(armadillo) { closed("A_organic/armadillo/armadillo.obj", 0, 0.856); }
TEST(camel) { closed("A_organic/camel/camel.off", 0, 1.558); }
TEST(elephant) { closed("A_organic/elephant/elephant.off", 0, 1.560); }
TEST(fertility) { closed("A_organic/fertility/fertility.off", 0, 1.80); }
TEST(hand) { closed("A_organic/hand_closed/hand_closed.obj", 0, 1.56); }
TEST(horse) { closed("A_organic/horse/horse.ply", 0, 1.05); }
TEST(scorpion) { closed("A_organic/scorpion/scorpion.obj", 0, 0.612); }
TEST(spot) { closed("C_textured/spot_cow/spot_triangulated.obj", 0, 1.692); }

/* At twice the default omega thin parts are merged; loops and places hold. */
TEST(coarse_horse) { closed("A_organic/horse/horse.ply", 0.025, 1.05); }
TEST(coarse_hand) { closed("A_organic/hand_closed/hand_closed.obj", 0.025, 1.56); }
TEST(coarse_armadillo) { closed("A_organic/armadillo/armadillo.obj", 0.025, 0.92); } /* 0.96 without the fingers that the contraction merges */
TEST(coarse_spot) { closed("C_textured/spot_cow/spot_triangulated.obj", 0.025, 1.692); } /* 2.10 without the legs and the tail */
TEST(coarse_elephant) { closed("A_organic/elephant/elephant.off", 0.018, 1.7); }
TEST(coarse_fertility) { closed("A_organic/fertility/fertility.off", 0.018, 1.9); }

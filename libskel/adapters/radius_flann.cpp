// Ball sums through FLANN's KDTreeSingleIndex: the exact index without randomness. The result set sums on the fly, so no
// neighbour list is ever stored (FLANN's own lists take 12 bytes a neighbour and query, and sort by default).
#include <cstdint>
#include <vector>

#include <flann/flann.hpp>

#include "cxx_guard.hpp"
#include "skel_radius.h"
#include "svo_task.h"

namespace {

using distance = flann::L2_Simple<float>;
using tree = flann::KDTreeSingleIndex<distance>;

// Adds up what lies within the squared radius. The tree is searched a little wider, because its bounds on whole
// branches are running sums with rounding errors; the distances it hands over are exact to the rule of skel_radius.h.
class ball final : public flann::ResultSet<float> {
public:
    ball(const int32_t *points, const uint32_t *weights, float squared) : points_(points), weights_(weights), squared_(squared), wider_(squared * 1.0001f) {}
    bool full() const override { return true; }
    float worstDist() const override { return wider_; }
    void addPoint(float squared_distance, size_t index) override
    {
        if (!(squared_distance < squared_)) return;
        const int32_t *p = points_ + 3 * index;
        const int64_t w = weights_[index];
        sum.x += w * p[0];
        sum.y += w * p[1];
        sum.z += w * p[2];
        sum.weight += w;
    }
    skel_ball_sum sum{};

private:
    const int32_t *points_;
    const uint32_t *weights_;
    float squared_, wider_;
};

struct query {
    const tree *index;
    const float *floats;
    const int32_t *points;
    const uint32_t *weights;
    const uint8_t *doublings;
    float squared;
    skel_ball_sum *out;
};

svo_result search(void *user, uint64_t begin, uint64_t end, uint32_t, svo_error *err)
{
    return svo_guard(err, [&] {
        const query &q = *static_cast<const query *>(user);
        flann::SearchParams parameters(flann::FLANN_CHECKS_UNLIMITED, 0.0f, false);
        for (uint64_t i = begin; i < end; i++) {
            const float wider = q.doublings == nullptr ? 1.0f : static_cast<float>(1u << 2 * q.doublings[i]); // a power of two: exact
            ball b(q.points, q.weights, q.squared * wider);
            q.index->findNeighbors(b, q.floats + 3 * i, parameters);
            q.out[i] = b.sum;
        }
        return SVO_OK;
    });
}

} // namespace

extern "C" svo_result skel_radius_flann(const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, double radius,
                                        uint32_t threads, skel_ball_sum *out, svo_error *err)
{
    return svo_guard(err, [&] {
        if (count == 0) return SVO_OK;
        if (count > INT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu points are too many for the radius search", static_cast<unsigned long long>(count));
        std::vector<float> floats(3 * count);
        for (uint64_t i = 0; i < 3 * count; i++) floats[i] = static_cast<float>(points[i]) * (1.0f / SKEL_LATTICE);
        tree index(flann::Matrix<float>(floats.data(), count, 3), flann::KDTreeSingleIndexParams(30, true));
        index.buildIndex();
        const float r = static_cast<float>(radius);
        query q{&index, floats.data(), points, weights, doublings, r * r, out};
        return svo_parallel_for(count < 2048 ? 1 : threads, count, 512, search, &q, err);
    });
}

// Ball sums through FLANN's KDTreeSingleIndex: the exact index without randomness. Points of one small cell share a search that is wider by their reach; each of them then sums
// what of its result is in its own ball. So the tree is searched a few times less often than once a point, and what is left is a loop over arrays. FLANN's own lists (12 bytes a
// neighbour and query, sorted by default) are never made.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <flann/flann.hpp>

#include "cxx_guard.hpp"
#include "skel_radius.h"
#include "svo_task.h"

namespace {

using distance = flann::L2_Simple<float>;
using tree = flann::KDTreeSingleIndex<distance>;

constexpr double cell_size = 2.5;       // of the radius
constexpr uint32_t most_members = 128; // of a group, so that threads have something to share where all points are in one cell

// What is found near a group: coordinates as FLANN has them, and weight * (coordinate, 1).
struct candidates {
    std::vector<float> x, y, z;
    std::vector<int64_t> wx, wy, wz, w;
    size_t count = 0;
    void room(size_t n)
    {
        if (n <= x.size()) return;
        const size_t more = n + n / 2 + 64;
        x.resize(more), y.resize(more), z.resize(more);
        wx.resize(more), wy.resize(more), wz.resize(more), w.resize(more);
    }
};

// Collects all points within the squared radius, which is a little wider than needed: FLANN's bounds on whole branches are running sums with rounding errors.
class collector final : public flann::ResultSet<float> {
public:
    collector(const float *floats, const int32_t *points, const uint32_t *weights, float squared, candidates &to) : floats_(floats), points_(points), weights_(weights), squared_(squared), to_(to) { to_.count = 0; }
    bool full() const override { return true; }
    float worstDist() const override { return squared_; }
    void addPoint(float squared_distance, size_t index) override
    {
        if (!(squared_distance < squared_)) return;
        const size_t n = to_.count++;
        to_.room(n + 1);
        const int32_t *p = points_ + 3 * index;
        const int64_t weight = weights_[index];
        to_.x[n] = floats_[3 * index], to_.y[n] = floats_[3 * index + 1], to_.z[n] = floats_[3 * index + 2];
        to_.wx[n] = weight * p[0], to_.wy[n] = weight * p[1], to_.wz[n] = weight * p[2], to_.w[n] = weight;
    }

private:
    const float *floats_;
    const int32_t *points_;
    const uint32_t *weights_;
    float squared_;
    candidates &to_;
};

// The sum of the candidates in the ball of p, by the rule of skel_radius.h.
skel_ball_sum sum_of(const candidates &c, const float *p, float squared)
{
    const float *const cx = c.x.data(), *const cy = c.y.data(), *const cz = c.z.data();
    const int64_t *const wx = c.wx.data(), *const wy = c.wy.data(), *const wz = c.wz.data(), *const ww = c.w.data();
    int64_t x = 0, y = 0, z = 0, w = 0;
    for (size_t i = 0; i < c.count; i++) {
        const float dx = p[0] - cx[i], dy = p[1] - cy[i], dz = p[2] - cz[i];
        const int64_t in = -static_cast<int64_t>((dx * dx + dy * dy) + dz * dz < squared);
        x += wx[i] & in;
        y += wy[i] & in;
        z += wz[i] & in;
        w += ww[i] & in;
    }
    return {x, y, z, w};
}

// Points of one cell and one radius: members[start[g]] .. members[start[g + 1] - 1].
struct groups {
    std::vector<uint32_t> start, members;
};

groups group_points(const int32_t *points, const uint8_t *doublings, uint64_t count, double radius)
{
    int32_t low[3] = {points[0], points[1], points[2]};
    for (uint64_t i = 1; i < count; i++)
        for (int k = 0; k < 3; k++) low[k] = std::min(low[k], points[3 * i + static_cast<uint64_t>(k)]);
    const double wide = std::fmax(radius * cell_size * SKEL_LATTICE, 64.0); // at most 2^19 cells a side
    const double inverse = 1 / std::fmin(wide, 1e9);
    uint64_t capacity = 64;
    while (capacity < 2 * count) capacity *= 2;
    std::vector<uint64_t> key(capacity, UINT64_MAX);
    std::vector<uint32_t> last(capacity), group_of(count), size;
    groups out;
    for (uint64_t i = 0; i < count; i++) {
        uint64_t cell = doublings == nullptr ? 0 : static_cast<uint64_t>(doublings[i]);
        for (int k = 0; k < 3; k++) cell = cell << 20 | static_cast<uint64_t>(static_cast<double>(points[3 * i + static_cast<uint64_t>(k)] - low[k]) * inverse);
        uint64_t hash = cell * 0x9e3779b97f4a7c15ull;
        uint64_t slot = (hash ^ hash >> 31) & (capacity - 1);
        while (key[slot] != UINT64_MAX && key[slot] != cell) slot = (slot + 1) & (capacity - 1);
        if (key[slot] == UINT64_MAX || size[last[slot]] == most_members) {
            key[slot] = cell;
            last[slot] = static_cast<uint32_t>(size.size());
            size.push_back(0);
        }
        group_of[i] = last[slot];
        size[last[slot]]++;
    }
    out.start.resize(size.size() + 1);
    out.members.resize(count);
    uint32_t sum = 0;
    for (size_t g = 0; g < size.size(); g++) {
        out.start[g] = sum;
        sum += size[g];
        size[g] = out.start[g];
    }
    out.start[size.size()] = sum;
    for (uint64_t i = 0; i < count; i++) out.members[size[group_of[i]]++] = static_cast<uint32_t>(i);
    return out;
}

struct query {
    const tree *index;
    const groups *group;
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
        candidates near;
        for (uint64_t g = begin; g < end; g++) {
            const uint32_t *first = q.group->members.data() + q.group->start[g], *last = q.group->members.data() + q.group->start[g + 1];
            const float wider = q.doublings == nullptr ? 1.0f : static_cast<float>(1u << 2 * q.doublings[*first]); // a power of two: exact
            const float squared = q.squared * wider;
            float middle[3], reach2 = 0;
            for (int k = 0; k < 3; k++) {
                float low = q.floats[3 * static_cast<size_t>(*first) + static_cast<size_t>(k)], high = low;
                for (const uint32_t *i = first; i < last; i++) {
                    const float at = q.floats[3 * static_cast<size_t>(*i) + static_cast<size_t>(k)];
                    low = std::min(low, at), high = std::max(high, at);
                }
                middle[k] = low + (high - low) / 2;
                const float half = std::max(high - middle[k], middle[k] - low);
                reach2 += half * half;
            }
            const float wide = std::sqrt(squared) + std::sqrt(reach2);
            collector found(q.floats, q.points, q.weights, wide * wide * 1.001f, near);
            q.index->findNeighbors(found, middle, parameters);
            for (const uint32_t *i = first; i < last; i++) q.out[*i] = sum_of(near, q.floats + 3 * static_cast<size_t>(*i), squared);
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
        tree index(flann::Matrix<float>(floats.data(), count, 3), flann::KDTreeSingleIndexParams(60, true));
        index.buildIndex();
        const float r = static_cast<float>(radius);
        const groups group = group_points(points, doublings, count, radius);
        query q{&index, &group, floats.data(), points, weights, doublings, r * r, out};
        return svo_parallel_for(count < 1024 ? 1 : threads, group.start.size() - 1, 8, search, &q, err);
    });
}

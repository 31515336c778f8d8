// Ball sums through FLANN's KDTreeSingleIndex: the exact index without randomness. Points of one small cell are a group with one list of what is near it: all that is in the ball of a member, and all that
// may get there while no point moves farther than half the skin (neighbour lists, Verlet 1967; the skin is how much wider they are). As long as that holds the lists serve call after call, and the tree is neither built nor searched. The few
// points that have moved farther are strays: lists pass them by, each group looks at all of them, and each of them searches the tree, which knows where the others were. What is in a ball is always
// decided by where points are now, so lists, skins and strays change no bit. FLANN's own lists (12 bytes a neighbour and query, sorted by default) are never made.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include <flann/flann.hpp>

#include "cxx_guard.hpp"
#include "skel_radius.h"
#include "svo_task.h"

namespace {

using distance = flann::L2_Simple<float>;
using tree = flann::KDTreeSingleIndex<distance>;

constexpr double cell_size = 2.5;       // of the radius
constexpr uint32_t most_members = 128;  // of a group, so that threads have something to share where all points are in one cell
constexpr float most_skin = 1.0f;     // of the radius: wider lists cost more than they save
constexpr float sweeps_ahead = 12;      // that a skin is made for
constexpr uint64_t few = 1024;          // points that are not worth a thread
constexpr uint32_t gone = UINT32_MAX;
constexpr uint64_t large = 131072;      // points from which on lists are kept only when a third of them is left: they and the tree take up to 80 bytes a point
constexpr float slack = 1.001f;         // on squared distances: FLANN's bounds on whole branches are running sums with rounding errors

// Points of a call. There may be millions at first, so what can be had from these is not kept.
struct points_of_call {
    const int32_t *place;
    const uint32_t *weight;
    std::vector<uint8_t> strayed;
    float at(uint64_t i, int k) const { return static_cast<float>(place[3 * i + static_cast<uint64_t>(k)]) * (1.0f / SKEL_LATTICE); } // as FLANN has it
    std::array<float, 3> at(uint64_t i) const { return {at(i, 0), at(i, 1), at(i, 2)}; }
};

// What is near a group, where it is now.
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
    // Those of n points that do not stray, or all of them.
    void add(const points_of_call &from, const uint32_t *index, size_t n, bool strays_too) // room is there
    {
        float *const px = x.data(), *const py = y.data(), *const pz = z.data();
        int64_t *const sx = wx.data(), *const sy = wy.data(), *const sz = wz.data(), *const sw = w.data();
        size_t to = count;
        for (size_t k = 0; k < n; k++) {
            const size_t j = index[k];
            const int32_t *p = from.place + 3 * j;
            const int64_t weight = from.weight[j];
            px[to] = from.at(j, 0), py[to] = from.at(j, 1), pz[to] = from.at(j, 2);
            sx[to] = weight * p[0], sy[to] = weight * p[1], sz[to] = weight * p[2], sw[to] = weight;
            to += strays_too || from.strayed[j] == 0;
        }
        count = to;
    }
};

// Collects the indices of all points within a squared distance.
class collector final : public flann::ResultSet<float> {
public:
    collector(float squared, std::vector<uint32_t> &to) : squared_(squared), to_(to) {}
    bool full() const override { return true; }
    float worstDist() const override { return squared_; }
    void addPoint(float squared_distance, size_t index) override
    {
        if (squared_distance < squared_) to_.push_back(static_cast<uint32_t>(index));
    }

private:
    float squared_;
    std::vector<uint32_t> &to_;
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

float squared_distance(const float *a, const float *b)
{
    const float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
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
    while (capacity < count + count / 2) capacity *= 2;
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

constexpr size_t block = 65536;         // of a worker's store; blocks stay where they are, and growing does not copy them

struct list { // of a group
    uint32_t *at;           // in a block
    uint64_t count;
    float middle[3], reach; // of all members when it was made
};

struct seen { // by a worker
    std::vector<uint32_t> strays;
    uint32_t by_way[256]; // points by the exponent of the square of how far they have come
};

} // namespace

struct skel_flann {
    float radius = 0;
    uint32_t threads = 1;
    // as of when the lists were made
    std::vector<float> before;   // of points that are left
    std::unique_ptr<tree> index; // of all; it has them in its own order, and is built from `before` as it was then, which it does not read any more
    std::vector<uint32_t> left;  // for each of all: which point it is now, or gone
    groups group;
    std::vector<list> lists;
    std::vector<std::vector<std::vector<uint32_t>>> store; // blocks a worker
    float skin = 0;
    uint64_t age = 0; // calls since then
    float speed = INFINITY; // that most points keep below, a call
    // of the call
    points_of_call now{};
    uint64_t count = 0, begun = 0; // points; at first
    std::vector<uint32_t> strays; // by x
    bool listed = false;          // these are the points of the lists
    std::vector<seen> sight;      // a worker
    std::vector<candidates> near; // a worker
    std::vector<std::vector<uint32_t>> found;
    const uint8_t *doublings = nullptr;
    skel_ball_sum *out = nullptr;

    void weld(const uint32_t *label, uint32_t welded);
    float radius_of(uint32_t i) const { return doublings == nullptr ? radius : radius * static_cast<float>(1u << doublings[i]); } // times a power of two: exact
    void look(uint64_t begin, uint64_t end, uint32_t worker);
    bool still_serve();
    svo_result make_lists(svo_error *err);
    void drop_lists();
    bool keeps_lists() const { return count <= large || count <= begun / 3; }
    void list_group(size_t g, uint32_t worker);
    void sum_group(size_t g, uint32_t worker);
    void sum_stray(uint32_t i, uint32_t worker);
};

namespace {

const flann::SearchParams parameters(flann::FLANN_CHECKS_UNLIMITED, 0.0f, false);

svo_result look(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    return svo_guard(err, [&] {
        static_cast<skel_flann *>(user)->look(begin, end, worker);
        return SVO_OK;
    });
}

svo_result list_groups(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    return svo_guard(err, [&] {
        for (uint64_t g = begin; g < end; g++) static_cast<skel_flann *>(user)->list_group(g, worker);
        return SVO_OK;
    });
}

svo_result sum_groups(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    return svo_guard(err, [&] {
        for (uint64_t g = begin; g < end; g++) static_cast<skel_flann *>(user)->sum_group(g, worker);
        return SVO_OK;
    });
}

svo_result sum_strays(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    return svo_guard(err, [&] {
        for (uint64_t k = begin; k < end; k++) static_cast<skel_flann *>(user)->sum_stray(static_cast<skel_flann *>(user)->strays[k], worker);
        return SVO_OK;
    });
}

} // namespace

// Which points have strayed, and how far they all are.
void skel_flann::look(uint64_t begin, uint64_t end, uint32_t worker)
{
    const float half = skin / 2 * 0.999f, squared = half * half;
    seen &to = sight[worker];
    for (uint64_t i = begin; i < end; i++) {
        const float way = squared_distance(now.at(i).data(), before.data() + 3 * i);
        to.by_way[std::clamp(std::ilogb(way) + 128, 0, 255)]++;
        now.strayed[i] = way >= squared;
        if (way >= squared) to.strays.push_back(static_cast<uint32_t>(i));
    }
}

// Do the lists still serve? Not where too many have strayed.
bool skel_flann::still_serve()
{
    const uint64_t most = std::min<uint64_t>(32 + count / 32, 2000);
    uint64_t by_way[256] = {0}, fast = 0;
    for (const seen &s : sight) {
        strays.insert(strays.end(), s.strays.begin(), s.strays.end());
        for (int k = 0; k < 256; k++) by_way[k] += s.by_way[k];
    }
    age++;
    int k = 255;
    while (k > 0 && fast + by_way[k] <= most / 2) fast += by_way[k--];
    speed = std::sqrt(std::ldexp(2.0f, k - 128)) / static_cast<float>(age);
    if (!(skin > 0 && strays.size() <= most)) return false;
    std::sort(strays.begin(), strays.end(), [&](uint32_t i, uint32_t j) { return now.place[3 * static_cast<size_t>(i)] < now.place[3 * static_cast<size_t>(j)]; });
    return true;
}

void skel_flann::list_group(size_t g, uint32_t worker)
{
    const uint32_t *first = group.members.data() + group.start[g], *last = group.members.data() + group.start[g + 1];
    std::vector<uint32_t> &near_it = found[worker];
    list &l = lists[g];
    float reach2 = 0;
    for (int k = 0; k < 3; k++) {
        float low = now.at(*first, k), high = low;
        for (const uint32_t *i = first; i < last; i++) {
            const float at = now.at(*i, k);
            low = std::min(low, at), high = std::max(high, at);
        }
        l.middle[k] = low + (high - low) / 2;
        const float half = std::max(high - l.middle[k], l.middle[k] - low);
        reach2 += half * half;
    }
    l.reach = std::sqrt(reach2);
    const float wide = radius_of(*first) + l.reach + skin;
    near_it.clear();
    collector all(wide * wide * slack, near_it);
    index->findNeighbors(all, l.middle, parameters);
    l.count = near_it.size();
    if (!keeps_lists()) {
        l.at = near_it.data();
        sum_group(g, worker);
        return;
    }
    auto &blocks = store[worker];
    if (blocks.empty() || blocks.back().capacity() - blocks.back().size() < l.count) {
        blocks.emplace_back();
        blocks.back().reserve(std::max<size_t>(l.count, block));
    }
    l.at = blocks.back().data() + blocks.back().size();
    blocks.back().insert(blocks.back().end(), near_it.begin(), near_it.end());
}

void skel_flann::drop_lists()
{
    index.reset();
    group = {};
    lists = {};
    for (auto &s : store) s = {};
    left = {};
    before = {};
    age = 0;
}

svo_result skel_flann::make_lists(svo_error *err)
{
    skin = sweeps_ahead * speed * 2;
    if (skin > most_skin * radius) skin = speed * 4 < most_skin * radius ? most_skin * radius : 0; // too fast for lists to last
    drop_lists(); // before there are others
    before.resize(3 * count);
    for (uint64_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) before[3 * i + static_cast<uint64_t>(k)] = now.at(i, k);
    left.resize(keeps_lists() ? count : 0);
    for (uint64_t i = 0; i < left.size(); i++) left[i] = static_cast<uint32_t>(i);
    index = std::make_unique<tree>(flann::Matrix<float>(before.data(), count, 3), flann::KDTreeSingleIndexParams(60, true));
    index->buildIndex();
    group = group_points(now.place, doublings, count, radius);
    lists.resize(group.start.size() - 1);
    strays.clear();
    now.strayed.assign(count, 0);
    return svo_parallel_for(count < few ? 1 : threads, lists.size(), 8, list_groups, this, err);
}

void skel_flann::sum_group(size_t g, uint32_t worker)
{
    const list &l = lists[g];
    if (group.start[g] == group.start[g + 1]) return; // all were welded to members of others
    const uint32_t *first = group.members.data() + group.start[g], *last = group.members.data() + group.start[g + 1];
    candidates &c = near[worker];
    c.count = 0;
    c.room(l.count + strays.size() + 1);
    c.add(now, l.at, l.count, false);
    const float r = radius_of(*first), wide = r + l.reach + skin, wide2 = wide * wide * slack;
    const auto beyond = [&](uint32_t j, float x) { return now.at(j, 0) < x; };
    for (auto j = std::lower_bound(strays.begin(), strays.end(), l.middle[0] - wide * slack, beyond); j != strays.end() && now.at(*j, 0) <= l.middle[0] + wide * slack; ++j)
        if (squared_distance(now.at(*j).data(), l.middle) < wide2) c.add(now, &*j, 1, true);
    for (const uint32_t *i = first; i < last; i++)
        if (now.strayed[*i] == 0) out[*i] = sum_of(c, now.at(*i).data(), r * r);
}

void skel_flann::sum_stray(uint32_t i, uint32_t worker)
{
    candidates &c = near[worker];
    std::vector<uint32_t> &around = found[worker];
    const float r = radius_of(i), wide = r + skin;
    around.clear();
    collector all(wide * wide * slack, around);
    std::array<float, 3> p = now.at(i);
    index->findNeighbors(all, p.data(), parameters);
    c.count = 0;
    c.room(around.size() + strays.size() + 1);
    for (const uint32_t k : around)
        if (left[k] != gone) c.add(now, &left[k], 1, false);
    c.add(now, strays.data(), strays.size(), true);
    out[i] = sum_of(c, p.data(), r * r);
}

// The first of those that are welded stands for all. Who is near it was listed for it, and lists with others of them know it as well: no point has moved farther than half the skin from where it
// was, strays aside, and the first does not become one by its new place without being seen.
void skel_flann::weld(const uint32_t *label, uint32_t welded)
{
    std::vector<uint32_t> first(welded, gone);
    for (uint32_t i = 0; i < before.size() / 3; i++)
        if (first[label[i]] == gone) first[label[i]] = i;
    const auto compact = [&](uint32_t *p, size_t n) {
        size_t to = 0;
        for (size_t k = 0; k < n; k++)
            if (first[label[p[k]]] == p[k]) p[to++] = label[p[k]];
        return to;
    };
    for (list &l : lists) l.count = compact(l.at, l.count);
    uint32_t at = 0;
    for (size_t g = 0; g < lists.size(); g++) {
        const uint32_t n = static_cast<uint32_t>(compact(group.members.data() + group.start[g], group.start[g + 1] - group.start[g]));
        std::copy_n(group.members.begin() + group.start[g], n, group.members.begin() + at);
        group.start[g] = at;
        at += n;
    }
    group.start[lists.size()] = at;
    for (uint32_t &k : left)
        if (k != gone) k = first[label[k]] == k ? label[k] : gone;
    std::vector<float> kept(3 * static_cast<size_t>(welded));
    for (uint32_t g = 0; g < welded; g++) std::copy_n(before.begin() + 3 * static_cast<ptrdiff_t>(first[g]), 3, kept.begin() + 3 * static_cast<ptrdiff_t>(g));
    before = std::move(kept);
}

extern "C" svo_result skel_flann_weld(skel_flann *f, const uint32_t *label, uint32_t count, svo_error *err)
{
    return svo_guard(err, [&] {
        if (!f->before.empty()) f->weld(label, count);
        return SVO_OK;
    });
}

extern "C" svo_result skel_flann_open(double radius, uint32_t threads, skel_flann **out, svo_error *err)
{
    return svo_guard(err, [&] {
        auto f = std::make_unique<skel_flann>();
        f->radius = static_cast<float>(radius);
        f->threads = threads != 0 ? threads : svo_processor_count();
        f->store.resize(f->threads);
        f->near.resize(f->threads);
        f->found.resize(f->threads);
        f->sight.resize(f->threads);
        *out = f.release();
        return SVO_OK;
    });
}

extern "C" void skel_flann_close(skel_flann *f) { delete f; }

extern "C" svo_result skel_flann_sums(skel_flann *f, const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, bool moved, skel_ball_sum *out, svo_error *err)
{
    return svo_guard(err, [&] {
        if (count == 0) return SVO_OK;
        if (count > INT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu points are too many for the radius search", static_cast<unsigned long long>(count));
        f->now.place = points, f->now.weight = weights, f->doublings = doublings, f->out = out;
        f->now.strayed.resize(count);
        f->count = count;
        if (f->begun == 0) f->begun = count;
        f->strays.clear();
        f->listed = moved && f->before.size() == 3 * count;
        for (seen &s : f->sight) s.strays.clear(), std::fill_n(s.by_way, 256, 0);
        if (f->listed) SVO_TRY(svo_parallel_for(f->threads, count, 4 * few, look, f, err));
        if (!(f->listed && f->still_serve())) SVO_TRY(f->make_lists(err));
        const uint32_t threads = count < few ? 1 : f->threads;
        if (!f->keeps_lists()) { // the sums are there already
            f->drop_lists();
            return SVO_OK;
        }
        SVO_TRY(svo_parallel_for(threads, f->lists.size(), 8, sum_groups, f, err));
        return svo_parallel_for(threads, f->strays.size(), 4, sum_strays, f, err);
    });
}

extern "C" svo_result skel_radius_flann(const int32_t *points, const uint32_t *weights, const uint8_t *doublings, uint64_t count, double radius, uint32_t threads, skel_ball_sum *out, svo_error *err)
{
    skel_flann *f = nullptr;
    SVO_TRY(skel_flann_open(radius, threads, &f, err));
    const svo_result r = skel_flann_sums(f, points, weights, doublings, count, false, out, err);
    skel_flann_close(f);
    return r;
}

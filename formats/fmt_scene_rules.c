/* The rules of .svscene, which writing and reading obey alike. */
#include <math.h>
#include <string.h>

#include "fmt_utf8.h"
#include "fmti_scene.h"
#include "svo_deform.h"
#include "svo_task.h"

svo_result fmti_scene_bad(svo_error *err, svo_result code, uint32_t chunk, uint64_t index, const char *rule, const char *what)
{
    char name[5];
    fmt_fourcc_text(chunk, name);
    svo_fail(err, code, "%s %llu: %s (%s)", name, (unsigned long long)index, what, rule);
    if (err != NULL) err->chunk = chunk, err->index = index;
    return code;
}

bool fmti_scene_name_start(const svo_scene *s, uint64_t offset)
{
    return offset < s->names_size && (offset == 0 || s->names[offset - 1] == 0);
}

static svo_result check_names(const svo_scene *s, svo_result code, svo_rules *rules, svo_error *err)
{
    if (s->names_size == 0 || s->names_size > UINT32_MAX || s->names[0] != 0 || s->names[s->names_size - 1] != 0)
        return fmti_scene_bad(err, code, NAME, 0, "SCN-03", "the table does not begin and end with a NUL");
    if (!fmt_utf8_valid(s->names, s->names_size)) return fmti_scene_bad(err, code, NAME, 0, "SCN-03", "not UTF-8");
    for (uint64_t i = 0; s->instance_name != NULL && i < s->instance_count; i++)
        if (!fmti_scene_name_start(s, s->instance_name[i])) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, code, INAM, i, "SCN-03", "not the start of a name"), err));
    return SVO_OK;
}

typedef struct page_check {
    const svo_scene *scene;
    const svo_extent *extents;
    bool poses_hold; /* all of them: the bounds of what has one can be told */
    svo_result code;
    svo_rules *rules;
} page_check;

static svo_result check_instance(const page_check *c, uint32_t p, uint64_t i, svo_error *err)
{
    const svo_scene *s = c->scene;
    const svo_scene_page *page = &s->pages[p];
    svo_result code = c->code;
    uint32_t asset = s->instance_asset[i];
    if (asset >= s->asset_count) return fmti_scene_bad(err, code, IAST, i, "SCN-06", "there is no such asset");
    if (s->instance_pose != NULL && s->instance_pose[i] != SVO_NO_POSE && s->instance_pose[i] >= s->poses.count)
        return fmti_scene_bad(err, code, IPOS, i, "SCN-11", "there is no such pose");
    svo_mat4 m = svo_scene_instance_transform(s, p, i), inverse;
    bool finite = true;
    for (int k = 0; k < 12; k++) finite = finite && isfinite(m.m[k]);
    if (!finite || !svo_mat4_affine_inverse(&m, &inverse)) return fmti_scene_bad(err, code, IXFM, i, "SCN-07", "the transform is not finite or not invertible");
    bool posed = svo_scene_instance_pose(s, i) != NULL;
    if (s->assets[asset]->empty || (posed && !c->poses_hold)) return SVO_OK; /* told where assets and poses are looked at */
    double low[3], high[3];
    bool good = svo_scene_instance_bounds(s, p, i, &c->extents[asset], low, high);
    for (int k = 0; k < 3; k++) {
        /* sines and cosines differ in their last bits between machines */
        double slack = posed ? 1e-9 * fmax(fabs(low[k]), fabs(high[k])) : 0;
        good = good && low[k] >= page->low[k] - slack && high[k] <= page->high[k] + slack;
    }
    return good ? SVO_OK : fmti_scene_bad(err, code, PAGE, p, "SCN-10", "the bounds do not hold all instances of the page");
}

static svo_result check_page(const page_check *c, uint32_t p, svo_error *err)
{
    const svo_scene_page *page = &c->scene->pages[p];
    for (int k = 0; k < 3; k++)
        if (!isfinite(page->low[k]) || !isfinite(page->high[k]) || !isfinite(page->origin[k]) || page->low[k] > page->high[k])
            return fmti_scene_bad(err, c->code, PAGE, p, "SCN-05", "bounds or origin are not finite or not in order");
    for (uint64_t i = page->first; i < page->first + page->count; i++) SVO_TRY(svo_go_on(c->rules, check_instance(c, p, i, err), err));
    return SVO_OK;
}

static svo_result check_page_range(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    const page_check *c = user;
    for (uint64_t p = begin; p < end; p++) SVO_TRY(svo_go_on(c->rules, check_page(c, (uint32_t)p, err), err));
    return SVO_OK;
}

static svo_result check_pages(const svo_scene *s, const svo_extent *extents, bool *used, bool poses_hold, bool partial, svo_result code, svo_rules *rules, svo_error *err)
{
    uint64_t next = 0;
    for (uint32_t p = 0; p < s->page_count; p++) {
        if (s->pages[p].first != next || s->pages[p].count == 0 || s->pages[p].count > s->instance_count - next)
            return fmti_scene_bad(err, code, PAGE, p, "SCN-04", "the page does not follow the one before it");
        next += s->pages[p].count;
    }
    if (next != s->instance_count) return fmti_scene_bad(err, code, PAGE, s->page_count, "SCN-04", "the pages do not hold all instances");
    page_check check = {s, extents, poses_hold, code, rules};
    if (rules != NULL) SVO_TRY(check_page_range(&check, 0, s->page_count, 0, err)); /* in order */
    else SVO_TRY(svo_parallel_for(0, s->page_count, 4, check_page_range, &check, err));
    for (uint64_t i = 0; i < s->instance_count; i++)
        if (s->instance_asset[i] < s->asset_count) used[s->instance_asset[i]] = true;
    for (uint32_t a = 0; a < s->asset_count && !partial; a++)
        if (!used[a]) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, code, ASET, a, "SCN-06", "no instance uses the asset"), err));
    return SVO_OK;
}

static svo_result check_poses(const svo_scene *s, svo_result code, svo_rules *rules, svo_error *err)
{
    for (uint64_t i = 0; i < 12 * s->poses.matrix_count; i++)
        if (!isfinite(s->poses.matrix[i])) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, code, PMAT, i / 12, "SCN-12", "a matrix is not finite"), err));
    for (uint32_t i = 0; i < s->poses.count; i++) {
        const char *fault = svo_pose_fault(&s->poses, &s->poses.pose[i]);
        if (fault != NULL) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, code, POSE, i, "SCN-12", fault), err));
    }
    return SVO_OK;
}

static svo_result check_camera(const svo_scene *s, svo_result code, svo_error *err)
{
    if (!s->has_camera) return SVO_OK;
    const double *m = s->camera_transform.m;
    svo_mat4 inverse;
    bool good = m[12] == 0 && m[13] == 0 && m[14] == 0 && m[15] == 1;
    for (int i = 0; i < 16; i++) good = good && isfinite(m[i]);
    good = good && svo_mat4_affine_inverse(&s->camera_transform, &inverse);
    /* (NaN fails both comparisons) */
    if (!good || !(s->camera_yfov > 0) || !(s->camera_yfov < 3.14159265358979312))
        return fmti_scene_bad(err, code, CAMR, 0, "SCN-09", "the camera is not affine, invertible and with a field of view below pi");
    return SVO_OK;
}

svo_result fmti_scene_check(const svo_scene *s, bool partial, svo_result code, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    SVO_TRY(svo_go_on(rules, check_names(s, code, rules, err), err));
    uint64_t before = rules != NULL ? rules->count : 0;
    SVO_TRY(check_poses(s, code, rules, err));
    bool poses_hold = rules == NULL || rules->count == before;
    SVO_TRY(svo_go_on(rules, check_camera(s, code, err), err));
    if (s->asset_count == 0 && s->instance_count != 0) return fmti_scene_bad(err, code, HEAD, 0, "SCN-06", "instances without assets");
    if (s->asset_count == 0) return s->page_count == 0 ? SVO_OK : fmti_scene_bad(err, code, PAGE, 0, "SCN-04", "a page without instances");
    svo_extent *extents = svo_calloc(a, s->asset_count, sizeof *extents);
    bool *used = svo_calloc(a, s->asset_count, sizeof *used), made = false;
    svo_result result = extents == NULL || used == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %u assets", s->asset_count) : SVO_OK;
    for (uint32_t i = 0; i < s->asset_count && !partial && result == SVO_OK; i++)
        if (s->assets[i]->empty) result = svo_go_on(rules, fmti_scene_bad(err, code, ASET, i, "SCN-08", "the asset is empty"), err);
    if (result == SVO_OK) result = svo_scene_extents(s, a, extents, err);
    made = result == SVO_OK;
    if (result == SVO_OK) result = check_pages(s, extents, used, poses_hold, partial, code, rules, err);
    for (uint32_t i = 0; made && i < s->asset_count; i++) svo_extent_free(&extents[i]);
    svo_free(a, extents, s->asset_count, sizeof *extents);
    svo_free(a, used, s->asset_count, sizeof *used);
    return result;
}

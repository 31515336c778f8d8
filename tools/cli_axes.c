#include "cli_axes.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

const char *const cli_axes_ups[] = {"y", "-y", "x", "-x", "z", "-z", NULL};

/* Turns by quarters: rows say where x, y and z of the result come from. */
static const signed char turns[][9] = {
    {1, 0, 0, 0, 1, 0, 0, 0, 1},   {1, 0, 0, 0, -1, 0, 0, 0, -1}, /* y, -y */
    {0, -1, 0, 1, 0, 0, 0, 0, 1},  {0, 1, 0, -1, 0, 0, 0, 0, 1},  /* x, -x */
    {1, 0, 0, 0, 0, 1, 0, -1, 0},  {1, 0, 0, 0, 0, -1, 0, 1, 0},  /* z, -z */
};

static bool read_unit(const char *text, double *metres)
{
    static const struct { const char *name; double metres; } units[] = {{"m", 1}, {"km", 1000}, {"cm", 0.01}, {"mm", 0.001}, {"in", 0.0254}, {"ft", 0.3048}};
    for (size_t i = 0; i < sizeof units / sizeof *units; i++)
        if (strcmp(text, units[i].name) == 0) return *metres = units[i].metres, true;
    char *end;
    *metres = strtod(text, &end);
    return end != text && *end == 0 && *metres >= 1e-30 && *metres <= 1e30;
}

int cli_take_axes(cli *c, cli_axes *a)
{
    a->metres = 1;
    if (a->unit != NULL && !read_unit(a->unit, &a->metres)) return cli_usage(c, "--unit: m, km, cm, mm, in, ft, or a number of metres (1e-30 to 1e30)");
    a->matrix = svo_mat4_identity();
    for (int i = 0; i < 9; i++) a->matrix.m[4 * (i / 3) + i % 3] = turns[a->up][i] * a->metres + 0.0; /* no negative zero */
    return -1;
}

bool cli_axes_given(const cli_axes *a) { return a->up != 0 || a->unit != NULL; }

void cli_put_axes(json_t *how, const cli_axes *a)
{
    if (a->up != 0) cli_put_text(how, "up", cli_axes_ups[a->up]);
    if (a->unit != NULL) cli_put_f64(how, "unit", a->metres);
}

void cli_turn_mesh(const cli_axes *a, svo_mesh *mesh)
{
    if (a->up == 0 && a->metres == 1) return;
    for (uint32_t i = 0; i < mesh->instance_count; i++) mesh->instances[i].transform = svo_mat4_mul(a->matrix, mesh->instances[i].transform);
    svo_mat4 turn = a->matrix; /* a camera does not grow, it stands elsewhere */
    for (int i = 0; i < 12; i++) turn.m[i] /= a->metres;
    for (uint32_t i = 0; i < mesh->camera_count; i++) {
        svo_mat4 *m = &mesh->cameras[i].transform;
        *m = svo_mat4_mul(turn, *m);
        for (int k = 0; k < 3; k++) m->m[4 * k + 3] *= a->metres;
    }
}

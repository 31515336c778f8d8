/* svo-bench: the plot. Two panels with logarithmic axes: error against run time and error against bytes. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"

enum {
    WIDTH = 1000, PANEL_WIDTH = 390, PANEL_HEIGHT = 400, FIRST_LEFT = 75, SECOND_LEFT = 560,
    COMMAND_CHARACTERS = 140, COMMAND_LINES = 4, LEGEND_COLUMNS = 3, NAME_CHARACTERS = 44,
    MAX_LABELLED = 400, /* points that get a label; all have a tooltip */
    MAX_TICKS = 200
};

/* Okabe and Ito's colours, which people with colour-blindness can tell apart; the marker's shape changes too. */
static const char *const colors[] = {"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8c6d00", "#56b4e9", "#000000", "#e69f00"};
enum { COLORS = sizeof colors / sizeof *colors };

typedef enum axis_unit { UNIT_SECONDS, UNIT_BYTES, UNIT_PLAIN } axis_unit;

/* Decimal logarithms to pixels. */
typedef struct axis {
    double low, high; /* logarithms */
    double from, to;  /* pixels */
    axis_unit unit;
    bool edge; /* some value is 0 and is drawn at `from` */
} axis;

typedef struct tick { double value; bool labelled; } tick;
typedef struct box { double x, y, w, h; } box;

typedef struct panel {
    const bench *b;
    bench_text *out;
    bench_column cost, error, error_max;
    bool front_is_bytes;
    double left, top;
    axis x, y;
    char x_title[80];
    box taken[3 * MAX_LABELLED];
    uint32_t taken_count;
} panel;

void bench_text_xml(bench_text *t, const char *text)
{
    for (const unsigned char *p = (const unsigned char *)text; *p != 0; p++) {
        bool noncharacter = p[0] == 0xef && p[1] == 0xbf && (p[2] == 0xbe || p[2] == 0xbf);
        if (*p == '&') bench_text_add(t, "&amp;");
        else if (*p == '<') bench_text_add(t, "&lt;");
        else if (*p == '>') bench_text_add(t, "&gt;");
        else if (*p == '"') bench_text_add(t, "&quot;");
        else if (*p == '\'') bench_text_add(t, "&#39;");
        else if (*p < 0x20 || *p == 0x7f || noncharacter) bench_text_add(t, "\xef\xbf\xbd");
        else bench_text_add(t, "%c", *p);
        if (noncharacter) p += 2;
    }
}

/* --- axes --------------------------------------------------------------------------------------------------------- */

static double place(const axis *a, double value)
{
    if (!(value > 0)) return a->from;
    return a->from + (log10(value) - a->low) / (a->high - a->low) * (a->to - a->from);
}

static void widen(axis *a, double value)
{
    if (!isfinite(value)) return;
    if (value <= 0) {
        a->edge = true;
        return;
    }
    double l = log10(value);
    if (l < a->low) a->low = l;
    if (l > a->high) a->high = l;
}

/* Some room on both sides, more where values of 0 are drawn at the edge. */
static void settle(axis *a)
{
    if (a->low > a->high) a->low = -1, a->high = 0;
    double span = a->high - a->low, least = 0.12;
    if (span < least) {
        a->low -= (least - span) / 2;
        a->high += (least - span) / 2;
        span = least;
    }
    a->low -= (a->edge ? 0.12 : 0.06) * span;
    a->high += 0.08 * span;
}

static void format_tick(axis_unit unit, double v, char out[32])
{
    static const struct { double least; const char *name; } seconds[] = {{1, "s"}, {1e-3, "ms"}, {0, "\xc2\xb5s"}};
    static const struct { double least; const char *name; } bytes[] = {{1e9, "GB"}, {1e6, "MB"}, {1e3, "kB"}, {0, "B"}};
    double slack = v * (1 + 1e-9);
    if (unit == UNIT_SECONDS) {
        int i = slack >= seconds[0].least ? 0 : slack >= seconds[1].least ? 1 : 2;
        snprintf(out, 32, "%.6g %s", v / (i == 2 ? 1e-6 : seconds[i].least), seconds[i].name);
    } else if (unit == UNIT_BYTES) {
        int i = slack >= bytes[0].least ? 0 : slack >= bytes[1].least ? 1 : slack >= bytes[2].least ? 2 : 3;
        snprintf(out, 32, "%.6g %s", v / (i == 3 ? 1 : bytes[i].least), bytes[i].name);
    } else {
        snprintf(out, 32, "%.6g", v);
    }
}

/* Powers of ten; where they are few, also 2 and 5 times them; where those are few, round numbers at equal distances. */
static uint32_t make_ticks(const axis *a, tick out[MAX_TICKS])
{
    int first = (int)floor(a->low), last = (int)ceil(a->high), powers = 0, fives = 0;
    for (int e = first; e <= last; e++) {
        for (int m = 1; m <= 5; m += m == 2 ? 3 : 1) {
            if (m > 2 && m < 5) continue;
            double l = e + log10(m);
            if (l < a->low || l > a->high) continue;
            powers += m == 1;
            fives++;
        }
    }
    uint32_t n = 0;
    if (fives < 3) {
        double low = pow(10, a->low), high = pow(10, a->high), rough = (high - low) / 4, power = pow(10, floor(log10(rough)));
        double step = rough / power < 1.5 ? power : rough / power < 3.5 ? 2 * power : rough / power < 7.5 ? 5 * power : 10 * power;
        for (double k = ceil(low / step); k * step <= high && n < MAX_TICKS; k++) out[n++] = (tick){k * step, true};
        return n;
    }
    int every = powers > 8 ? (powers + 7) / 8 : 1;
    for (int e = first; e <= last; e++) {
        for (int m = 1; m <= 9; m++) {
            double l = e + log10(m);
            if (l < a->low || l > a->high || n == MAX_TICKS || (m > 1 && powers > 5)) continue;
            bool labelled = m == 1 ? ((e % every) + every) % every == 0 : powers < 3 && (m == 2 || m == 5);
            out[n++] = (tick){m * pow(10, e), labelled};
        }
    }
    return n;
}

static void draw_axis(panel *p, bool vertical)
{
    const axis *a = vertical ? &p->y : &p->x;
    tick ticks[MAX_TICKS];
    uint32_t n = make_ticks(a, ticks);
    for (uint32_t i = 0; i < n; i++) {
        double at = place(a, ticks[i].value);
        const char *shade = ticks[i].labelled ? "#cccccc" : "#eeeeee";
        if (vertical) bench_text_add(p->out, "<path d=\"M%.1f %.1fh%d\" stroke=\"%s\"/>\n", p->left, at, PANEL_WIDTH, shade);
        else bench_text_add(p->out, "<path d=\"M%.1f %.1fv%d\" stroke=\"%s\"/>\n", at, p->top, PANEL_HEIGHT, shade);
    }
    double last = -1e9;
    for (uint32_t i = 0; i < n; i++) {
        if (!ticks[i].labelled) continue;
        char text[32];
        double at = place(a, ticks[i].value);
        format_tick(a->unit, ticks[i].value, text);
        if (vertical) {
            bench_text_add(p->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\" class=\"tick\">%s</text>\n", p->left - 6, at + 4, text);
        } else if (at - last > 6.5 * (double)strlen(text) + 4) {
            bench_text_add(p->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\" class=\"tick\">%s</text>\n", at, p->top + PANEL_HEIGHT + 17, text);
            last = at;
        }
    }
}

/* --- curves ------------------------------------------------------------------------------------------------------- */

static bool shown(const panel *p, const bench_row *row)
{
    return row->result == SVO_OK && isfinite(row->value[p->cost]) && isfinite(row->value[p->error]);
}

/* In the sweep of methods a line joins the omegas of one method. */
static bool same_line(const bench *b, uint32_t v)
{
    const char *now = b->values[v].label, *before = v > 0 ? b->values[v - 1].label : now;
    size_t words = strcspn(now, "@");
    return b->sweep != SWEEP_METHOD || (words == strcspn(before, "@") && strncmp(now, before, words) == 0);
}

static void draw_line(panel *p, uint32_t model, bench_column column, const char *style)
{
    bool started = false;
    for (uint32_t v = 0; v < p->b->value_count; v++) {
        const bench_row *row = bench_row_at(p->b, model, v);
        if (started && !same_line(p->b, v)) {
            bench_text_add(p->out, "\" fill=\"none\" stroke=\"%s\" %s/>\n", colors[model % COLORS], style);
            started = false;
        }
        if (!shown(p, row) || !isfinite(row->value[column])) continue;
        bench_text_add(p->out, "%s%.1f,%.1f", started ? " " : "<polyline points=\"", place(&p->x, row->value[p->cost]), place(&p->y, row->value[column]));
        started = true;
    }
    if (started) bench_text_add(p->out, "\" fill=\"none\" stroke=\"%s\" %s/>\n", colors[model % COLORS], style);
}

typedef struct corner { double cost, error; } corner;

static int by_cost(const void *a, const void *b)
{
    const corner *x = a, *y = b;
    return x->cost != y->cost ? (x->cost > y->cost) - (x->cost < y->cost) : (x->error < y->error) - (x->error > y->error);
}

/* The front as stairs: what is above and right of it costs more without being better. */
static void draw_front(panel *p, uint32_t model)
{
    corner corners[BENCH_MAX_VALUES];
    uint32_t n = 0;
    for (uint32_t v = 0; v < p->b->value_count; v++) {
        const bench_row *row = bench_row_at(p->b, model, v);
        if (shown(p, row) && (p->front_is_bytes ? row->front_bytes : row->front_seconds)) corners[n++] = (corner){row->value[p->cost], row->value[p->error]};
    }
    if (n < 2) return;
    qsort(corners, n, sizeof *corners, by_cost);
    bench_text_add(p->out, "<path d=\"M%.1f %.1f", place(&p->x, corners[0].cost), place(&p->y, corners[0].error));
    for (uint32_t i = 1; i < n; i++) bench_text_add(p->out, "H%.1fV%.1f", place(&p->x, corners[i].cost), place(&p->y, corners[i].error));
    bench_text_add(p->out, "\" fill=\"none\" stroke=\"%s\" stroke-width=\"4\" stroke-opacity=\"0.16\"/>\n", colors[model % COLORS]);
}

static void marker(bench_text *out, uint32_t model, double x, double y, bool front, bool edge)
{
    const char *color = colors[model % COLORS];
    uint32_t shape = model % 4;
    if (shape == 0) bench_text_add(out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"4\"", x, y);
    else if (shape == 1) bench_text_add(out, "<path d=\"M%.1f %.1fh7v7h-7z\"", x - 3.5, y - 3.5);
    else if (shape == 2) bench_text_add(out, "<path d=\"M%.1f %.1fl4.5 8h-9z\"", x, y - 5);
    else bench_text_add(out, "<path d=\"M%.1f %.1fl5 5l-5 5l-5 -5z\"", x, y - 5);
    bench_text_add(out, " fill=\"%s\" stroke=\"%s\" stroke-width=\"1.4\"%s/>", front ? color : "#ffffff", color, edge ? " stroke-dasharray=\"2 1.2\"" : "");
}

static bool take_box(panel *p, box a)
{
    for (uint32_t i = 0; i < p->taken_count; i++) {
        const box *t = &p->taken[i];
        if (a.x < t->x + t->w && t->x < a.x + a.w && a.y < t->y + t->h && t->y < a.y + a.h) return false;
    }
    if (p->taken_count < 3 * MAX_LABELLED) p->taken[p->taken_count++] = a;
    return true;
}

/* Beside the point where nothing else is; where there is no room the tooltip must do. */
static void draw_label(panel *p, uint32_t model, double x, double y, const char *text)
{
    double w = 6 * (double)strlen(text), h = 10;
    const double at[8][2] = {{6, -h - 1}, {-w - 6, 3}, {-w / 2, -h - 6}, {-w / 2, 6}, {7, -h / 2}, {-w - 7, -h / 2}, {6, 2}, {-w - 6, -h - 2}};
    for (int i = 0; i < 8; i++) {
        box a = {x + at[i][0], y + at[i][1], w, h};
        if (a.x < p->left || a.x + a.w > p->left + PANEL_WIDTH || a.y < p->top || a.y + a.h > p->top + PANEL_HEIGHT || !take_box(p, a)) continue;
        bench_text_add(p->out, "<text x=\"%.1f\" y=\"%.1f\" class=\"label\" style=\"fill:%s\">", a.x, a.y + h - 1.5, colors[model % COLORS]);
        bench_text_xml(p->out, text);
        bench_text_add(p->out, "</text>\n");
        return;
    }
}

static void draw_point(panel *p, uint32_t model, uint32_t v)
{
    const bench_row *row = bench_row_at(p->b, model, v);
    char cost[32], error[32];
    double x = row->value[p->cost], y = row->value[p->error];
    bool front = p->front_is_bytes ? row->front_bytes : row->front_seconds;
    format_tick(p->x.unit, x, cost);
    format_tick(p->y.unit, y, error);
    bench_text_add(p->out, "<g class=\"point\"><title>");
    bench_text_xml(p->out, p->b->models[model].name);
    bench_text_add(p->out, ", %s ", bench_sweep_names[p->b->sweep]);
    bench_text_xml(p->out, p->b->values[v].label);
    bench_text_add(p->out, ": %s, error %s%s</title>", cost, error, front ? ", on the Pareto front" : "");
    marker(p->out, model, place(&p->x, x), place(&p->y, y), front, !(x > 0) || !(y > 0));
    bench_text_add(p->out, "</g>\n");
}

static void draw_points(panel *p)
{
    const bench *b = p->b;
    uint32_t labelled = 0;
    for (uint32_t m = 0; m < b->model_count; m++) {
        for (uint32_t v = 0; v < b->value_count; v++) {
            const bench_row *row = bench_row_at(b, m, v);
            if (!shown(p, row)) continue;
            draw_point(p, m, v);
            if (labelled++ < MAX_LABELLED) take_box(p, (box){place(&p->x, row->value[p->cost]) - 4, place(&p->y, row->value[p->error]) - 4, 8, 8});
        }
    }
    labelled = 0;
    for (uint32_t m = 0; m < b->model_count; m++) {
        for (uint32_t v = 0; v < b->value_count; v++) {
            const bench_row *row = bench_row_at(b, m, v);
            if (shown(p, row) && labelled++ < MAX_LABELLED) draw_label(p, m, place(&p->x, row->value[p->cost]), place(&p->y, row->value[p->error]), b->values[v].label);
        }
    }
}

static void draw_panel(panel *p, const char *y_title)
{
    const bench *b = p->b;
    p->x = (axis){INFINITY, -INFINITY, p->left, p->left + PANEL_WIDTH, p->front_is_bytes ? UNIT_BYTES : UNIT_SECONDS, false};
    p->y = (axis){INFINITY, -INFINITY, p->top + PANEL_HEIGHT, p->top, UNIT_PLAIN, false};
    for (uint64_t i = 0; i < (uint64_t)b->model_count * b->value_count; i++) {
        if (!shown(p, &b->rows[i])) continue;
        widen(&p->x, b->rows[i].value[p->cost]);
        widen(&p->y, b->rows[i].value[p->error]);
        widen(&p->y, b->rows[i].value[p->error_max]);
    }
    settle(&p->x);
    settle(&p->y);
    bench_text_add(p->out, "<g class=\"panel\">\n");
    draw_axis(p, false);
    draw_axis(p, true);
    bench_text_add(p->out, "<path d=\"M%.1f %.1fh%dv%dh-%dz\" fill=\"none\" stroke=\"#666666\"/>\n", p->left, p->top, PANEL_WIDTH, PANEL_HEIGHT, PANEL_WIDTH);
    for (uint32_t m = 0; m < b->model_count; m++) {
        draw_front(p, m);
        draw_line(p, m, p->error_max, "stroke-width=\"1\" stroke-dasharray=\"2 4\"");
        draw_line(p, m, p->error, "stroke-width=\"1.5\"");
    }
    draw_points(p);
    bench_text_add(p->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\">%s</text>\n", p->left + PANEL_WIDTH / 2.0, p->top + PANEL_HEIGHT + 38, p->x_title);
    double x = p->left - 58, y = p->top + PANEL_HEIGHT / 2.0;
    bench_text_add(p->out, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"middle\" transform=\"rotate(-90 %.1f %.1f)\">%s</text>\n</g>\n", x, y, x, y, y_title);
}

/* --- words -------------------------------------------------------------------------------------------------------- */

/* Length in bytes of the first `characters` characters of UTF-8 text, or of all of it. */
static size_t prefix(const char *text, uint32_t characters)
{
    size_t n = 0;
    while (text[n] != 0) {
        bool starts = ((unsigned char)text[n] & 0xc0) != 0x80;
        if (starts && characters-- == 0) break;
        n++;
    }
    return n;
}

static void add_cut(bench_text *out, const char *text, size_t length, bool dots)
{
    char *part = malloc(length + 1);
    if (part == NULL) {
        out->failed = true;
        return;
    }
    memcpy(part, text, length);
    part[length] = 0;
    bench_text_xml(out, part);
    if (dots) bench_text_add(out, "\xe2\x80\xa6");
    free(part);
}

/* The command in lines, broken at blanks. Returns the height used. */
static double draw_command(const bench *b, bench_text *out, double y)
{
    const char *at = b->command;
    int line = 0;
    for (; *at != 0 && line < COMMAND_LINES; line++) {
        size_t length = prefix(at, COMMAND_CHARACTERS), cut = length;
        while (at[length] != 0 && cut > 0 && at[cut] != ' ') cut--;
        if (cut > 0) length = cut;
        bench_text_add(out, "<text x=\"20\" y=\"%.1f\" class=\"command\">%s", y + 15 * line, line == 0 ? "" : "\xc2\xa0\xc2\xa0");
        bool more = line == COMMAND_LINES - 1 && at[length] != 0;
        add_cut(out, at, length, more);
        bench_text_add(out, "</text>\n");
        at += length;
        while (*at == ' ') at++;
    }
    return 15 * line;
}

static double draw_legend(const bench *b, bench_text *out, double y)
{
    uint32_t rows = (b->model_count + LEGEND_COLUMNS - 1) / LEGEND_COLUMNS;
    for (uint32_t m = 0; m < b->model_count; m++) {
        double x = 20 + (double)(m % LEGEND_COLUMNS) * 325, at = y + (double)(m / LEGEND_COLUMNS) * 18;
        const char *name = b->models[m].name;
        size_t length = prefix(name, NAME_CHARACTERS);
        bench_text_add(out, "<g class=\"legend\"><path d=\"M%.1f %.1fh26\" stroke=\"%s\" stroke-width=\"1.5\"/>", x, at - 4, colors[m % COLORS]);
        marker(out, m, x + 13, at - 4, true, false);
        bench_text_add(out, "<text x=\"%.1f\" y=\"%.1f\">", x + 33, at);
        add_cut(out, name, length, name[length] != 0);
        bench_text_add(out, "</text></g>\n");
    }
    return 18.0 * rows;
}

static void draw_notes(const bench *b, bench_text *out, double y, bool edge)
{
    const bench_axes axes = bench_axes_of(b);
    uint64_t failed = 0;
    for (uint64_t i = 0; i < (uint64_t)b->model_count * b->value_count; i++) failed += b->rows[i].result != SVO_OK;
    bench_text_add(out, "<text x=\"20\" y=\"%.1f\" class=\"note\">Filled: on the model's Pareto front (wide pale stairs); white: another point is better in both. Dotted line: %s.%s", y,
                   axes.max_note, edge ? " Broken outline at the edge: 0." : "");
    if (failed > 0) bench_text_add(out, " %llu failed point%s not shown.", (unsigned long long)failed, failed == 1 ? "" : "s");
    bench_text_add(out, "</text>\n<text x=\"20\" y=\"%.1f\" class=\"note\">svo-bench %s, ", y + 16, SVO_VERSION_STRING);
    json_t *host = bench_host(b->c);
    json_int_t processors = json_integer_value(json_object_get(host, "processors")), threads = json_integer_value(json_object_get(host, "threads"));
    const char *cpu = json_string_value(json_object_get(host, "processor")), *compiler = json_string_value(json_object_get(host, "compiler"));
    if (compiler != NULL) bench_text_xml(out, compiler);
    bench_text_add(out, "; %lld processor%s", (long long)processors, processors == 1 ? "" : "s");
    if (cpu != NULL) bench_text_add(out, " ("), bench_text_xml(out, cpu), bench_text_add(out, ")");
    bench_text_add(out, ", %lld thread%s; times are medians of %llu.</text>\n", (long long)threads, threads == 1 ? "" : "s", (unsigned long long)b->repeat);
    json_decref(host);
}

void bench_write_svg(const bench *b, bench_text *out)
{
    const bench_axes axes = bench_axes_of(b);
    bench_text body = {0};
    bench_text_add(&body, "<text x=\"20\" y=\"28\" class=\"title\">Error against run time and bytes: %s</text>\n", bench_sweep_names[b->sweep]);
    double top = 50 + draw_command(b, &body, 48) + 8;
    panel *p = calloc(1, sizeof *p);
    if (p == NULL) {
        out->failed = true;
        svo_buffer_free(&body.bytes);
        return;
    }
    bool edge = false;
    for (int i = 0; i < 2; i++) {
        *p = (panel){.b = b, .out = &body, .cost = i == 0 ? axes.seconds : axes.bytes, .error = axes.error, .error_max = axes.error_max,
                     .front_is_bytes = i == 1, .left = i == 0 ? FIRST_LEFT : SECOND_LEFT, .top = top};
        if (i == 0) snprintf(p->x_title, sizeof p->x_title, "%s, %s", axes.work_title, b->cpu ? "user time of all threads" : "wall time");
        else snprintf(p->x_title, sizeof p->x_title, "%s", axes.bytes_title);
        draw_panel(p, axes.error_title);
        edge |= p->x.edge || p->y.edge;
    }
    free(p);
    double y = top + PANEL_HEIGHT + 68;
    y += draw_legend(b, &body, y) + 6;
    draw_notes(b, &body, y, edge);
    bench_text_add(out,
                   "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
                   "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%.0f\" viewBox=\"0 0 %d %.0f\">\n"
                   "<style>text{font-family:sans-serif;font-size:13px;fill:#222222}.title{font-size:17px;font-weight:bold}.command{font-family:monospace;font-size:11px}"
                   ".tick{font-size:11px}.label{font-size:10px}.note{font-size:11px;fill:#555555}</style>\n"
                   "<rect width=\"100%%\" height=\"100%%\" fill=\"#ffffff\"/>\n",
                   WIDTH, y + 34, WIDTH, y + 34);
    if (body.failed || out->failed || svo_buffer_append(&out->bytes, body.bytes.data, body.bytes.size) == NULL) out->failed = true;
    bench_text_add(out, "</svg>\n");
    svo_buffer_free(&body.bytes);
}

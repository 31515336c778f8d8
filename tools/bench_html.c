/* The page of a sweep: command, plots, rows, meanings, host. No script, nothing from elsewhere. */
#include <math.h>
#include <string.h>

#include "bench.h"

static const char style[] =
    "body{font:15px/1.45 sans-serif;color:#222;margin:24px auto;max-width:1060px;padding:0 16px}h1{font-size:22px;margin:0 0 4px}h2{font-size:17px;margin:28px 0 6px}"
    "pre{background:#f4f4f4;padding:8px 10px;overflow:auto;font-size:12px}.wide{overflow-x:auto}table{border-collapse:collapse;font-size:12.5px;font-variant-numeric:tabular-nums}"
    "th,td{padding:2px 8px;text-align:right;white-space:nowrap;border-bottom:1px solid #ddd}th{position:sticky;top:0;background:#fff;border-bottom:2px solid #888}"
    ".l{text-align:left}.best{background:#e6f2e6}.bad{color:#a00;text-align:left}.meaning td{white-space:normal}svg{max-width:100%;height:auto;display:block}summary{cursor:pointer;margin:8px 0}";

static void put_head(const bench *b, bench_text *out)
{
    bench_text_add(out, "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>svo-bench: %s</title>\n<style>%s</style></head><body>\n",
                   bench_sweep_names[b->sweep], style);
    bench_text_add(out, "<h1>Error against run time and bytes: %s</h1>\n<pre class=\"command\">", bench_sweep_names[b->sweep]);
    bench_text_xml(out, b->command);
    bench_text_add(out, "</pre>\n");
}

/* The picture without its first line, which is for files. */
static void put_plots(const bench *b, bench_text *out)
{
    bench_text svg = {0};
    bench_write_svg(b, &svg);
    if (svg.failed || svo_buffer_append(&svg.bytes, "", 1) == NULL) {
        out->failed = true;
    } else {
        const char *begin = strstr((const char *)svg.bytes.data, "<svg");
        bench_text_add(out, "<div class=\"plots\">");
        if (!out->failed && begin != NULL && svo_buffer_append(&out->bytes, begin, strlen(begin)) == NULL) out->failed = true;
        bench_text_add(out, "</div>\n");
    }
    svo_buffer_free(&svg.bytes);
}

static void put_rows(const bench *b, bool brief, bench_text *out)
{
    bench_text_add(out, "<div class=\"wide\"><table class=\"%s\"><thead><tr><th class=\"l\">model</th><th>%s</th>", brief ? "rows" : "all", bench_sweep_names[b->sweep]);
    for (int i = 0; i < COL_COUNT; i++) {
        if (!bench_has_column(b, i) || (brief && bench_columns[i].brief == NULL)) continue;
        bench_text_add(out, "<th title=\"");
        bench_text_xml(out, bench_columns[i].meaning);
        bench_text_add(out, "\">");
        bench_text_xml(out, brief ? bench_columns[i].brief : bench_columns[i].name);
        bench_text_add(out, "</th>");
    }
    bench_text_add(out, "</tr></thead><tbody>\n");
    const bench_axes axes = bench_axes_of(b);
    for (uint32_t m = 0; m < b->model_count; m++)
        for (uint32_t v = 0; v < b->value_count; v++) {
            const bench_row *row = bench_row_at(b, m, v);
            bench_text_add(out, "<tr><td class=\"l\">");
            bench_text_xml(out, b->models[m].name);
            bench_text_add(out, "</td><td>");
            bench_text_xml(out, b->values[v].label);
            bench_text_add(out, "</td>");
            for (int i = 0; i < COL_COUNT && row->result == SVO_OK; i++) {
                if (!bench_has_column(b, i) || (brief && bench_columns[i].brief == NULL)) continue;
                char cell[40];
                bench_format_cell(row, i, cell);
                const bool best = (i == (int)axes.seconds && row->front_seconds) || (i == (int)axes.bytes && row->front_bytes);
                bench_text_add(out, "<td%s>%s</td>", best ? " class=\"best\"" : "", cell);
            }
            if (row->result != SVO_OK) {
                bench_text_add(out, "<td class=\"bad\" colspan=\"%d\">", (int)COL_COUNT);
                bench_text_xml(out, row->error);
                bench_text_add(out, "</td>");
            }
            bench_text_add(out, "</tr>\n");
        }
    bench_text_add(out, "</tbody></table></div>\n");
}

static void put_meanings(const bench *b, bench_text *out)
{
    bench_text_add(out, "<details><summary>What the columns mean</summary><table class=\"meaning\"><tbody>\n");
    for (int i = 0; i < COL_COUNT; i++) {
        if (!bench_has_column(b, i)) continue;
        bench_text_add(out, "<tr><td class=\"l\">");
        bench_text_xml(out, bench_columns[i].name);
        bench_text_add(out, "</td><td class=\"l\">");
        bench_text_xml(out, bench_columns[i].unit);
        bench_text_add(out, "</td><td class=\"l\">");
        bench_text_xml(out, bench_columns[i].meaning);
        bench_text_add(out, "</td></tr>\n");
    }
    bench_text_add(out, "</tbody></table></details>\n");
}

static void put_notes(const bench *b, bench_text *out)
{
    json_t *all = bench_json(b), *note, *value;
    const char *key;
    size_t i;
    bench_text_add(out, "<h2>Host and notes</h2>\n<table class=\"host\"><tbody>\n<tr><td class=\"l\">svokit</td><td class=\"l\">%s</td></tr>\n", SVO_VERSION_STRING);
    json_object_foreach(json_object_get(all, "host"), key, value) {
        bench_text_add(out, "<tr><td class=\"l\">%s</td><td class=\"l\">", key);
        if (json_is_string(value)) bench_text_xml(out, json_string_value(value));
        else bench_text_add(out, "%lld", (long long)json_integer_value(value));
        bench_text_add(out, "</td></tr>\n");
    }
    bench_text_add(out, "<tr><td class=\"l\">runs of a point</td><td class=\"l\">%llu</td></tr>\n<tr><td class=\"l\">clock</td><td class=\"l\">%s</td></tr>\n</tbody></table>\n<ul>\n", (unsigned long long)b->repeat,
                   b->cpu ? "user time of all threads" : "wall time");
    json_array_foreach(json_object_get(all, "notes"), i, note) {
        bench_text_add(out, "<li>");
        bench_text_xml(out, json_string_value(note));
        bench_text_add(out, "</li>\n");
    }
    bench_text_add(out, "<li>Green: on the model's Pareto front of error and that column.</li>\n</ul>\n");
    json_decref(all);
}

void bench_write_html(const bench *b, bench_text *out)
{
    put_head(b, out);
    put_plots(b, out);
    bench_text_add(out, "<h2>Rows</h2>\n");
    put_rows(b, true, out);
    bench_text_add(out, "<details><summary>All columns</summary>\n");
    put_rows(b, false, out);
    bench_text_add(out, "</details>\n");
    put_meanings(b, out);
    put_notes(b, out);
    bench_text_add(out, "</body></html>\n");
}

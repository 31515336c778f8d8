/* Writes large meshes for tests of memory: a bumpy sheet of two triangles a cell.
 * bench_mesh ply|obj|off|stl TRIANGLES OUT [shuffled] [torus|pierced|twice]
 * "shuffled": neighbouring vertices lie far from each other in the file, as in a scan with poor locality. "torus": the sheet is closed to a bumpy torus; "pierced": one of 997
 * of its triangles is missing; "twice": its second half is a smaller torus in another direction, which crosses the first one. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct sheet { unsigned long long columns, rows, vertices, step; int torus, twice; } sheet;

static unsigned long long common_divisor(unsigned long long a, unsigned long long b)
{
    while (b != 0) {
        unsigned long long r = a % b;
        a = b;
        b = r;
    }
    return a;
}

/* Number in the file of a vertex of the sheet; and which vertex of the sheet has a number. */
static unsigned long long number_of(const sheet *s, unsigned long long column, unsigned long long row)
{
    return (unsigned long long)((unsigned __int128)(row * (s->columns + !s->torus) + column) * s->step % s->vertices);
}

static void point(const sheet *s, unsigned long long column, unsigned long long row, float p[3])
{
    double x = (double)column / (double)s->columns, y = (double)row / (double)s->rows;
    if (s->torus) {
        const double turn = 6.283185307179586, v = s->twice ? 2 * y - (y >= 0.5) : y, r = 0.1 * (1 + 0.02 * sin(turn * 200 * x) * sin(turn * 150 * v)) / (1 + (s->twice && y >= 0.5));
        const double ring = 0.35 + r * cos(turn * v), a = ring * cos(turn * x), b = ring * sin(turn * x);
        p[0] = (float)(a + 0.5);
        p[1] = (float)(s->twice && y >= 0.5 ? b : r * sin(turn * v));
        p[2] = (float)((s->twice && y >= 0.5 ? r * sin(turn * v) : b) + 0.5);
        return;
    }
    p[0] = (float)x;
    p[1] = (float)(0.1 * sin(9 * x) * cos(7 * y) + 0.002 * sin(900 * x) * sin(700 * y));
    p[2] = (float)y;
}

/* Inverse of step modulo vertices. */
static unsigned long long inverse(unsigned long long a, unsigned long long m)
{
    __int128 old = (__int128)a, r = (__int128)m, x = 1, y = 0;
    while (r != 0) {
        __int128 q = old / r, t = old - q * r;
        old = r;
        r = t;
        t = x - q * y;
        x = y;
        y = t;
    }
    return (unsigned long long)((x % (__int128)m + (__int128)m) % (__int128)m);
}

int main(int argc, char **argv)
{
    if (argc < 4) return fprintf(stderr, "bench_mesh ply|obj|off|stl TRIANGLES OUT [shuffled] [torus|pierced|twice]\n"), 1;
    const char *format = argv[1];
    sheet s = {0};
    s.columns = (unsigned long long)sqrt(strtod(argv[2], NULL) / 2);
    int shuffled = 0, pierced = 0;
    for (int i = 4; i < argc; i++) {
        shuffled |= strcmp(argv[i], "shuffled") == 0;
        pierced |= strcmp(argv[i], "pierced") == 0;
        s.twice |= strcmp(argv[i], "twice") == 0;
        s.torus |= strcmp(argv[i], "shuffled") != 0;
    }
    s.columns -= s.columns % 2; /* twice has two halves */
    s.rows = s.columns;
    s.vertices = s.torus ? s.columns * s.rows : (s.columns + 1) * (s.rows + 1);
    s.step = 1;
    if (shuffled) {
        s.step = (unsigned long long)((double)s.vertices * 0.6180339887) | 1;
        while (common_divisor(s.step, s.vertices) != 1) s.step += 2;
    }
    unsigned long long back = inverse(s.step, s.vertices), triangles = 2 * s.columns * s.rows, all = triangles;
    if (pierced) triangles -= (all + 996) / 997;
    FILE *f = fopen(argv[3], "wb");
    if (f == NULL) return perror(argv[3]), 1;
    int ply = strcmp(format, "ply") == 0, obj = strcmp(format, "obj") == 0, off = strcmp(format, "off") == 0, stl = strcmp(format, "stl") == 0;
    if (ply) fprintf(f, "ply\nformat binary_little_endian 1.0\nelement vertex %llu\nproperty float x\nproperty float y\nproperty float z\n"
                        "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face %llu\nproperty list uchar uint vertex_indices\nend_header\n", s.vertices, triangles);
    if (off) fprintf(f, "OFF\n%llu %llu 0\n", s.vertices, triangles);
    if (stl) {
        char head[84] = "bumpy sheet";
        unsigned n = (unsigned)triangles;
        memcpy(head + 80, &n, 4);
        fwrite(head, 1, sizeof head, f);
    }
    for (unsigned long long i = 0; i < s.vertices && !stl; i++) {
        unsigned long long at = (unsigned long long)((unsigned __int128)i * back % s.vertices);
        float p[3];
        point(&s, at % (s.columns + !s.torus), at / (s.columns + !s.torus), p);
        if (ply) {
            unsigned char rgb[3] = {(unsigned char)(255 * p[0]), (unsigned char)(255 * p[2]), (unsigned char)(at % 256)};
            fwrite(p, 1, sizeof p, f);
            fwrite(rgb, 1, sizeof rgb, f);
        } else {
            fprintf(f, obj ? "v %.7g %.7g %.7g\n" : "%.7g %.7g %.7g\n", (double)p[0], (double)p[1], (double)p[2]);
            if (obj) fprintf(f, "vt %.6g %.6g\n", (double)p[0], (double)p[2]);
        }
    }
    for (unsigned long long row = 0; row < s.rows; row++)
        for (unsigned long long column = 0; column < s.columns; column++)
            for (int half = 0; half < 2; half++) {
                if (pierced && (2 * (row * s.columns + column) + (unsigned long long)half) % 997 == 0) continue;
                unsigned long long c[3] = {column + (unsigned long long)half, column + 1, column}, r[3] = {row, row + (unsigned long long)half, row + 1};
                const unsigned long long part = s.twice ? s.rows / 2 : s.rows, begin = row / part * part;
                for (int k = 0; s.torus && k < 3; k++) c[k] %= s.columns, r[k] = begin + (r[k] - begin) % part;
                if (stl) {
                    char record[50] = {0};
                    for (int k = 0; k < 3; k++) {
                        float p[3];
                        point(&s, c[k], r[k], p);
                        memcpy(record + 12 + 12 * k, p, 12);
                    }
                    fwrite(record, 1, sizeof record, f);
                    continue;
                }
                unsigned index[3];
                for (int k = 0; k < 3; k++) index[k] = (unsigned)number_of(&s, c[k], r[k]);
                if (ply) {
                    unsigned char record[13] = {3};
                    memcpy(record + 1, index, 12);
                    fwrite(record, 1, sizeof record, f);
                } else if (obj) {
                    fprintf(f, "f %u/%u %u/%u %u/%u\n", index[0] + 1, index[0] + 1, index[1] + 1, index[1] + 1, index[2] + 1, index[2] + 1);
                } else {
                    fprintf(f, "3 %u %u %u\n", index[0], index[1], index[2]);
                }
            }
    return fclose(f) != 0 ? (perror(argv[3]), 2) : 0;
}

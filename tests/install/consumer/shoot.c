/* Open the .svdag named on the command line and cast a ray along +x through the middle of its grid. Prints the distance, in
 * voxels from the grid's low side. */
#include <stdio.h>

#include <fmt_svdag.h>
#include <svo_raycast.h>

int main(int argc, char **argv)
{
    if (argc != 2) return 1;
    svo_error err;
    fmt_bytes bytes;
    fmt_svdag file;
    svo_result r = fmt_bytes_open(argv[1], 0, NULL, &bytes, &err);
    if (r == SVO_OK) {
        r = fmt_svdag_open(bytes.data, bytes.size, NULL, &file, &err);
        if (r == SVO_OK) {
            double middle = (double)(1u << file.view.depth) / 2 + 0.25;
            svo_ray ray = {.origin = {-1, middle, middle}, .direction = {1, 0, 0}, .t_max = 1e9};
            svo_hit hit;
            svo_raycast(&file.view, &ray, 1, &hit);
            printf("%g\n", hit.hit ? hit.t - 1 : -1);
            fmt_svdag_close(&file);
        }
        fmt_bytes_close(&bytes);
    }
    if (r != SVO_OK) fprintf(stderr, "%s\n", err.message);
    return svo_result_exit_code(r);
}

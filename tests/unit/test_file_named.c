/* The same promises where the file system has no unnamed files: the library's code without O_TMPFILE, in place of the
 * library's own object. */
#define _GNU_SOURCE
#include <fcntl.h>
#undef O_TMPFILE

#include "../../formats/fmt_file.c"

#include "test_file.c"

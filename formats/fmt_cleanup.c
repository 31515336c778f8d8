#include <stdatomic.h>
#include <stddef.h>
#include <unistd.h>

#include "fmt_file.h"
#include "fmti_cleanup.h"

enum { SLOTS = 64 };
static _Atomic(const char *) slots[SLOTS];

void fmti_temporary_remember(const char *path)
{
    for (int i = 0; i < SLOTS; i++) {
        const char *none = NULL;
        if (atomic_compare_exchange_strong(&slots[i], &none, path)) return;
    }
}

void fmti_temporary_forget(const char *path)
{
    for (int i = 0; i < SLOTS; i++) {
        const char *mine = path;
        if (atomic_compare_exchange_strong(&slots[i], &mine, NULL)) return;
    }
}

void fmt_output_remove_temporaries(void)
{
    for (int i = 0; i < SLOTS; i++) {
        const char *path = atomic_load(&slots[i]);
        if (path != NULL) unlink(path);
    }
}

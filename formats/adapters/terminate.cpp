#include "fmt_memory.h"

#include <cstdlib>
#include <exception>
#include <new>

namespace {

void (*chosen)(bool) = nullptr;

[[noreturn]] void on_terminate() noexcept
{
    bool out_of_memory = false;
    if (std::exception_ptr e = std::current_exception()) {
        try {
            std::rethrow_exception(e);
        } catch (const std::bad_alloc &) {
            out_of_memory = true;
        } catch (...) {
        }
    }
    if (chosen != nullptr) chosen(out_of_memory);
    std::abort();
}

} // namespace

extern "C" void fmt_set_terminate(void (*handler)(bool out_of_memory))
{
    chosen = handler;
    std::set_terminate(on_terminate);
}

/* The exception firewall between C and the C++ adapters. Every extern "C" function of an adapter
 * consists of one `return svo_guard(err, [&]() -> svo_result { ... });`; svo_guard is noexcept. Inside, adapter code may throw
 * svo_failure (with the code and text that the C side shall see), std::bad_alloc, or what a library throws. */
#ifndef CXX_GUARD_HPP
#define CXX_GUARD_HPP

#include "svo_base.h"

#include <cstdarg>
#include <cstdio>
#include <exception>
#include <new>
#include <stdexcept>

struct svo_failure {
    svo_error error;
};

[[noreturn]] inline void svo_throw(svo_result code, const char *format, ...) SVO_PRINTF(2, 3);
[[noreturn]] inline void svo_throw(svo_result code, const char *format, ...)
{
    svo_failure f{};
    f.error.code = code;
    va_list args;
    va_start(args, format);
    std::vsnprintf(f.error.message, sizeof f.error.message, format, args);
    va_end(args);
    throw f;
}

/* Throw what a C function reported. */
inline void svo_check(svo_result code, const svo_error &error)
{
    if (code == SVO_OK) return;
    svo_failure f{error};
    f.error.code = code;
    throw f;
}

template <class F> svo_result svo_guard(svo_error *err, F &&body) noexcept
{
    try {
        return body();
    } catch (const svo_failure &f) {
        if (err != nullptr) *err = f.error;
        return f.error.code;
    } catch (const std::bad_alloc &) {
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    } catch (const std::length_error &) {
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (a size beyond what can be addressed)");
    } catch (const std::exception &e) {
        return svo_fail(err, SVO_RUNTIME, "unexpected error in a library: %s", e.what());
    } catch (...) {
        return svo_fail(err, SVO_RUNTIME, "unexpected error in a library");
    }
}

#endif

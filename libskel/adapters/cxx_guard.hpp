// The exception firewall of the adapters: every extern "C" function is one `return svo::guard(err, [&] { ... });`.
#ifndef SVO_CXX_GUARD_HPP
#define SVO_CXX_GUARD_HPP

#include <exception>
#include <new>

#include "svo_base.h"

namespace svo {

template <typename F> svo_result guard(svo_error *err, F &&body) noexcept
{
    try {
        return body();
    } catch (const std::bad_alloc &) {
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    } catch (const std::exception &e) {
        return svo_fail(err, SVO_RUNTIME, "a library failed: %s", e.what());
    } catch (...) {
        return svo_fail(err, SVO_RUNTIME, "a library failed without saying why");
    }
}

} // namespace svo
#endif

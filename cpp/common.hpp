// Arrays of NumPy, checks of their shapes, and the choice of instructions when the program runs.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>

namespace nb = nanobind;
using std::ptrdiff_t;

template <class T> using Vector = nb::ndarray<T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class T> using Matrix = nb::ndarray<T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T> using Cube = nb::ndarray<T, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
template <class T> using Table4 = nb::ndarray<T, nb::ndim<4>, nb::c_contig, nb::device::cpu>;
template <class T> using Table5 = nb::ndarray<T, nb::ndim<5>, nb::c_contig, nb::device::cpu>;

// Raise ValueError in Python unless sizes agree: behind this border, loops trust them.
inline void require(bool condition, const char *expected) {
    if (!condition) throw nb::value_error(expected);
}

// A kernel runs outside the interpreter's lock.
using Unlocked = nb::call_guard<nb::gil_scoped_release>;

#if defined(_MSC_VER)
#define INLINE __forceinline
#define INLINE_LAMBDA
#define RESTRICT __restrict
#else
#define INLINE inline __attribute__((always_inline))
#define INLINE_LAMBDA __attribute__((always_inline))
#define RESTRICT __restrict__
#endif

// `fastest(loop)` runs a loop that was compiled twice: for every processor of the platform, and for AVX2 with FMA,
// which most of x86-64 have. What the loop calls has to be INLINE.
#if defined(__x86_64__) && (defined(__GNUC__) || defined(__clang__))
inline const bool has_avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");

template <class Loop> __attribute__((target("avx2,fma"), noinline)) void with_avx2(const Loop &loop) { loop(); }

template <class Loop> inline void fastest(const Loop &loop) {
    if (has_avx2)
        with_avx2(loop);
    else
        loop();
}
#else
template <class Loop> inline void fastest(const Loop &loop) { loop(); }
#endif

INLINE void prefetch(const void *address) {
#if defined(__GNUC__) || defined(__clang__)
    __builtin_prefetch(address);
#else
    (void)address;
#endif
}

constexpr double PI = 3.14159265358979323846;

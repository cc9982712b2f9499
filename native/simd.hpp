// Vectors of one instruction set. Every kernel is compiled once per instruction set, in the namespace NT_ISA
// (avx512, avx2 or plain), so that nothing compiled for one can be linked into another.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__AVX512F__) || defined(__AVX2__) || defined(__SSE2__)
#include <immintrin.h>
#endif

#define NT_INLINE inline __attribute__((always_inline))

namespace neurotact::NT_ISA {

#if defined(__AVX512F__)
constexpr int kVectorBytes = 64;
#elif defined(__AVX2__)
constexpr int kVectorBytes = 32;
#else
constexpr int kVectorBytes = 16;
#endif

template <class T>
constexpr int kWide = kVectorBytes / static_cast<int>(sizeof(T));

// The vector extensions of GCC and Clang: elementwise operators, never contracted (-ffp-contract=off).
template <class T, int L>
struct VectorOf {
    typedef T type __attribute__((vector_size(L * sizeof(T))));
};
template <class T>
struct IntegerFor;
template <>
struct IntegerFor<float> {
    using type = int32_t;
};
template <>
struct IntegerFor<double> {
    using type = int64_t;
};

// L lanes of T. `Mask` says which lanes hold; on AVX-512 it is a mask register, elsewhere a vector of all-ones.
template <class T, int L>
struct Simd {
    static constexpr int lanes = L;
    using V = typename VectorOf<T, L>::type;
    using Bits = typename VectorOf<typename IntegerFor<T>::type, L>::type;
    using Mask = Bits;

    static NT_INLINE Mask greater(V a, V b) { return a > b; }
    static NT_INLINE V clear(Mask m, V v) { return (V)(~m & (Bits)v); }
    static NT_INLINE V only(Mask m, V v) { return (V)(m & (Bits)v); }
    // The lanes whose bits are set, the lowest bit first.
    static NT_INLINE Mask lanes_of(uint64_t bits) {
        Bits lane{};
        for (int i = 0; i < L; i++) lane[i] = 1 << i;
        return (Mask)(((Bits{} + (typename IntegerFor<T>::type)(bits & ((1u << L) - 1))) & lane) != 0);
    }
    static NT_INLINE uint32_t bits(Mask m) {
#if defined(__AVX2__)
        if constexpr (L * sizeof(T) == 32 && sizeof(T) == 4) return (uint32_t)_mm256_movemask_ps((__m256)m);
        if constexpr (L * sizeof(T) == 32 && sizeof(T) == 8) return (uint32_t)_mm256_movemask_pd((__m256d)m);
#endif
#if defined(__SSE2__)
        if constexpr (L * sizeof(T) == 16 && sizeof(T) == 4) return (uint32_t)_mm_movemask_ps((__m128)m);
        if constexpr (L * sizeof(T) == 16 && sizeof(T) == 8) return (uint32_t)_mm_movemask_pd((__m128d)m);
#endif
        uint32_t packed = 0;
        for (int i = 0; i < L; i++) packed |= (uint32_t)(m[i] & 1) << i;
        return packed;
    }
};

#if defined(__AVX512F__)
#define NT_AVX512_SIMD(T, L, VECTOR, MASK, SUFFIX, WIDTH)                                            \
    template <>                                                                                      \
    struct Simd<T, L> {                                                                              \
        static constexpr int lanes = L;                                                              \
        using V = typename VectorOf<T, L>::type;                                                     \
        using Bits = typename VectorOf<typename IntegerFor<T>::type, L>::type;                       \
        using Mask = MASK;                                                                           \
        static NT_INLINE Mask greater(V a, V b) {                                                    \
            return _mm##WIDTH##_cmp_##SUFFIX##_mask((VECTOR)a, (VECTOR)b, _CMP_GT_OQ);               \
        }                                                                                            \
        static NT_INLINE V clear(Mask m, V v) { return (V)_mm##WIDTH##_maskz_mov_##SUFFIX(~m, (VECTOR)v); } \
        static NT_INLINE V only(Mask m, V v) { return (V)_mm##WIDTH##_maskz_mov_##SUFFIX(m, (VECTOR)v); }   \
        static NT_INLINE Mask lanes_of(uint64_t bits) { return (MASK)bits; }                         \
        static NT_INLINE uint32_t bits(Mask m) { return m; }                                         \
    };
NT_AVX512_SIMD(float, 16, __m512, __mmask16, ps, 512)
NT_AVX512_SIMD(double, 8, __m512d, __mmask8, pd, 512)
NT_AVX512_SIMD(float, 8, __m256, __mmask8, ps, 256)
#undef NT_AVX512_SIMD
#endif

template <class S, class T>
NT_INLINE typename S::V load(const T* at) {
    typename S::V v;
    std::memcpy(&v, at, sizeof v);
    return v;
}
template <class V, class T>
NT_INLINE void store(T* at, V v) {
    std::memcpy(at, &v, sizeof v);
}
template <class S, class T>
NT_INLINE typename S::V all(T value) {
    return value - typename S::V{};  // x - 0 is x and costs nothing, 0 + x is not where x is -0
}
template <class S>
NT_INLINE typename S::V magnitude(typename S::V v) {
    using Bits = typename S::Bits;
    const Bits sign = (Bits)(-typename S::V{});
    return (typename S::V)((Bits)v & ~sign);
}

// Asks for `count` values from `at` on, to read or to write them some steps later; they may lie outside of all memory.
template <bool ToWrite = false, class T>
NT_INLINE void fetch(const T* at, int count) {
    for (int i = 0; i < count; i += 64 / (int)sizeof(T)) __builtin_prefetch(at + i, ToWrite);
}

// The vectors of a layer, or of a panel of it. Copied vector by vector: GCC copies a structure in halves of a vector,
// and a load that finds its value in two stores waits for both.
template <class S, int N>
struct Vectors {
    typename S::V v[N];
    Vectors() = default;
    NT_INLINE Vectors(const Vectors& from) { *this = from; }
    NT_INLINE Vectors& operator=(const Vectors& from) {
        for (int q = 0; q < N; q++) v[q] = from.v[q];
        return *this;
    }
    NT_INLINE typename S::V& operator[](int q) { return v[q]; }
    NT_INLINE const typename S::V& operator[](int q) const { return v[q]; }
};
template <class S, int N, class T>
NT_INLINE Vectors<S, N> load_all(const T* at) {
    Vectors<S, N> to;
    for (int q = 0; q < N; q++) to[q] = load<S>(at + q * S::lanes);
    return to;
}
template <class S, int N, class T>
NT_INLINE void store_all(T* at, const Vectors<S, N>& from) {
    for (int q = 0; q < N; q++) store(at + q * S::lanes, from[q]);
}
// One value for all vectors.
template <class S>
struct Same {
    typename S::V v;
    NT_INLINE const typename S::V& operator[](int) const { return v; }
};

// Index of the lowest set bit, 64 where there is none.
NT_INLINE int lowest(uint64_t m) {
#if defined(__BMI__)
    return (int)_tzcnt_u64(m);
#else
    return m ? __builtin_ctzll(m) : 64;
#endif
}

}  // namespace neurotact::NT_ISA

// Spikes as bit masks: word k of a step holds neurons 64 k to 64 k + 63, the lowest bit first.
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace neurotact::NT_ISA {

// One step of `n` spikes into `words(n)` words; false where a value is neither 0 nor 1.
NT_INLINE bool pack_bytes(const uint8_t* from, int n, uint64_t* to) {
    uint64_t other = 0;
    for (int start = 0; start < n; start += 64) {
        const int count = n - start < 64 ? n - start : 64;
#if defined(__AVX512BW__)
        const __mmask64 lanes = count == 64 ? ~0ull : (1ull << count) - 1;
        const __m512i values = _mm512_maskz_loadu_epi8(lanes, from + start);
        to[start / 64] = _mm512_test_epi8_mask(values, values);
        other |= _mm512_cmpgt_epu8_mask(values, _mm512_set1_epi8(1));
#else
        // Eight bytes of 0 or 1 times this constant leave their bits side by side in the highest byte.
        uint64_t packed = 0;
        for (int i = 0; i < count; i += 8) {
            uint64_t eight = 0;
            if (count - i >= 8) {
                std::memcpy(&eight, from + start + i, 8);
            } else {
                for (int k = 0; k < count - i; k++) eight |= (uint64_t)from[start + i + k] << (8 * k);
            }
            other |= eight & ~0x0101010101010101ull;
            packed |= (((eight & 0x0101010101010101ull) * 0x0102040810204080ull) >> 56) << i;
        }
        to[start / 64] = packed;
#endif
    }
    return other == 0;
}

template <class F>
NT_INLINE bool pack_reals(const F* from, int n, uint64_t* to) {
    using S = Simd<F, kWide<F>>;
    using V = typename S::V;
    constexpr int L = S::lanes;
    typename S::Bits expected = {};
    expected = ~expected;
    bool binary = true;
    for (int64_t k = 0; k < words(n); k++) to[k] = 0;
    int i = 0;
    for (; i + L <= n; i += L) {
        const V v = load<S>(from + i);
        expected &= (typename S::Bits)((v == V{}) | (v == V{} + 1));
        to[i / 64] |= (uint64_t)S::bits(S::greater(v, V{})) << (i % 64);
    }
    for (int lane = 0; lane < L; lane++) binary &= expected[lane] != 0;
    for (; i < n; i++) {
        to[i / 64] |= (uint64_t)(from[i] == 1) << (i % 64);
        binary &= from[i] == 0 || from[i] == 1;
    }
    return binary;
}

NT_INLINE bool pack_step(const SpikesIn& spikes, int64_t trial, int64_t step, int n, uint64_t* to) {
    const int64_t at = trial * spikes.trial_stride + step * spikes.time_stride;
    if (spikes.kind == SpikesIn::byte) return pack_bytes((const uint8_t*)spikes.data + at, n, to);
    if (spikes.kind == SpikesIn::real32) return pack_reals((const float*)spikes.data + at, n, to);
    return pack_reals((const double*)spikes.data + at, n, to);
}

// A whole trial, step after step.
inline bool pack_trial(const SpikesIn& spikes, int64_t trial, int64_t steps, int n, uint64_t* to) {
    bool binary = true;
    const int64_t per_step = words(n);
    for (int64_t t = 0; t < steps; t++) binary &= pack_step(spikes, trial, t, n, to + t * per_step);
    return binary;
}

}  // namespace neurotact::NT_ISA

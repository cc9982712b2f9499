// The step of afferent LIF neurons, eight taxels side by side (neurotact/neurons.py, lif_step): the only place in C++.
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace neurotact::NT_ISA {

constexpr int kLanes = 8;  // taxels side by side

// U <- U_inf + (U - U_inf) decay with U_inf = v_rest + drive; U >= v_threshold spikes, and then U stays at v_reset
// for `silent_steps` steps.
template <class T>
struct Population {
    typename VectorOf<T, kLanes>::type membrane;
    typename VectorOf<int32_t, kLanes>::type silent;
};

template <class T>
struct Constants {
    typename VectorOf<T, kLanes>::type gain, decay, v_rest, v_reset, v_threshold;
    typename VectorOf<int32_t, kLanes>::type silent_steps;
};

template <class T>
NT_INLINE uint64_t lif_step(Population<T>& p, typename VectorOf<T, kLanes>::type drive, const Constants<T>& c) {
    using V = typename VectorOf<T, kLanes>::type;
    using Bits = typename VectorOf<typename IntegerFor<T>::type, kLanes>::type;
    using Ints = typename VectorOf<int32_t, kLanes>::type;
    using Bytes = typename VectorOf<uint8_t, kLanes>::type;
    const V target = c.v_rest + drive;
    const V moved = target + (p.membrane - target) * c.decay;
    const Ints awake32 = p.silent == 0;
    const Bits awake = __builtin_convertvector(awake32, Bits);
    const V membrane = awake ? moved : c.v_reset;
    const Bits fired = awake & (membrane >= c.v_threshold);
    const Ints fired32 = __builtin_convertvector(fired, Ints);
    p.membrane = fired ? c.v_reset : membrane;
    p.silent = fired32 ? c.silent_steps : (awake32 ? p.silent : p.silent - 1);
    const Bytes ones = __builtin_convertvector(fired32 & 1, Bytes);
    uint64_t eight;
    std::memcpy(&eight, &ones, 8);
    return eight;
}

// How much a signal has changed, rise or fall.
template <class T>
NT_INLINE typename VectorOf<T, kLanes>::type change_of(typename VectorOf<T, kLanes>::type now,
                                                       typename VectorOf<T, kLanes>::type last) {
    using V = typename VectorOf<T, kLanes>::type;
    using Bits = typename VectorOf<typename IntegerFor<T>::type, kLanes>::type;
    return (V)((Bits)(now - last) & ~(Bits)(-V{}));
}

// Spikes of SA-I and RA-I under eight taxels, a byte of 0 or 1 each, from the signal now and a step before.
template <class T>
NT_INLINE void afferent_step(Population<T>& slow, Population<T>& rapid, typename VectorOf<T, kLanes>::type now,
                             typename VectorOf<T, kLanes>::type last, const Constants<T>& sa, const Constants<T>& ra,
                             uint64_t& sa_fired, uint64_t& ra_fired) {
    sa_fired = lif_step(slow, sa.gain * now, sa);
    ra_fired = lif_step(rapid, ra.gain * change_of<T>(now, last), ra);
}

}  // namespace neurotact::NT_ISA

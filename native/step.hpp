// The CUBA-LIF step and its adjoint, on one vector of neurons: the only place where these equations stand in C++.
// They are those of neurotact/neurons.py, in the same order of operations, so that spikes agree to the last bit.
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace neurotact::NT_ISA {

// U[t+1] from U[t], I[t], I[t+1] and which neurons were above threshold at t:
//   eq4 beta (U[t] + I[t]),  delayed beta U[t] + I[t],  immediate beta U[t] + I[t+1];
//   zero multiplies the sum by (1 - s[t]), subtract takes threshold s[t] off it, hard sets U[t] to 0 before it.
template <class S, Membrane M, Reset R>
NT_INLINE typename S::V membrane_step(typename S::V membrane, typename S::V current_before, typename S::V current,
                                      typename S::Mask fired, typename S::V beta, typename S::V threshold) {
    using V = typename S::V;
    const V carried = R == Reset::hard ? S::clear(fired, membrane) : membrane;
    V sum;
    if constexpr (M == Membrane::eq4) sum = beta * (carried + current_before);
    if constexpr (M == Membrane::delayed) sum = beta * carried + current_before;
    if constexpr (M == Membrane::immediate) sum = beta * carried + current;
    if constexpr (R == Reset::zero) return S::clear(fired, sum);
    if constexpr (R == Reset::subtract) return sum - S::only(fired, threshold);
    return sum;
}

// The surrogate derivative 1 / (1 + scale |U - threshold|)^2 (texture paper, Eq. 7).
template <class S>
NT_INLINE typename S::V surrogate_slope(typename S::V membrane, typename S::V threshold, typename S::V scale) {
    const typename S::V wide = (typename S::V{} + 1) + scale * magnitude<S>(membrane - threshold);
    return (typename S::V{} + 1) / (wide * wide);
}

// What flows back through one step, for one vector of neurons.
template <class S>
struct Adjoint {
    typename S::V current{};   // dL/dI[t+1], as far as later steps made it
    typename S::V membrane{};  // dL/dU[t+1], likewise
};

// Step t backwards. `slope_gradient` is slope(U[t+1]) dL/ds[t+1], `fired` the reset of step t (U[t] > threshold).
// Returns the complete dL/dI[t+1] and leaves in `adjoint` the share of I[t] and U[t]; `sum_gradient` receives
// dL/d(sum) of membrane_step, from which beta's gradient comes.
template <class S, Membrane M, Reset R>
NT_INLINE typename S::V step_back(Adjoint<S>& adjoint, typename S::V slope_gradient, typename S::Mask fired,
                                  typename S::V alpha, typename S::V beta, typename S::V& sum_gradient) {
    using V = typename S::V;
    V through = adjoint.membrane + slope_gradient;
    if constexpr (R == Reset::zero) through = S::clear(fired, through);
    sum_gradient = through;
    const V decayed = beta * through;
    adjoint.membrane = R == Reset::hard ? S::clear(fired, decayed) : decayed;
    V current = adjoint.current;
    if constexpr (M == Membrane::immediate) current = current + through;
    adjoint.current = alpha * current;
    if constexpr (M == Membrane::eq4) adjoint.current = adjoint.current + decayed;
    if constexpr (M == Membrane::delayed) adjoint.current = adjoint.current + through;
    return current;
}

}  // namespace neurotact::NT_ISA

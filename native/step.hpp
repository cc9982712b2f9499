// The CUBA-LIF step and its adjoint, on the vectors of one layer: the only place where these equations stand in C++.
// They are those of neurotact/neurons.py, in the same order of operations, so that spikes agree to the last bit.
//
// Membrane and reset are values of the run: a branch that always goes one way costs next to nothing, and one
// compiled kernel a pair of them cost most of the build.
#pragma once

#include "kernels.hpp"
#include "simd.hpp"

namespace neurotact::NT_ISA {

// U[t+1] from U[t], I[t], I[t+1] and which neurons were above threshold at t:
//   eq4 beta (U[t] + I[t]),  delayed beta U[t] + I[t],  immediate beta U[t] + I[t+1];
//   zero multiplies the sum by (1 - s[t]), subtract takes threshold s[t] off it, hard sets U[t] to 0 before it.
// `beta` and `threshold` are Vectors, or Same where all neurons share a value; where thresholds adapt, `threshold` is
// theta[t].
template <class S, int N, class Betas, class Thresholds>
NT_INLINE void membrane_step(Neuron neuron, Vectors<S, N>& membrane, const Vectors<S, N>& current_before,
                             const Vectors<S, N>& current, const typename S::Mask (&fired)[N], const Betas& beta,
                             const Thresholds& threshold) {
    if (neuron.reset == Reset::hard)
        for (int q = 0; q < N; q++) membrane[q] = S::clear(fired[q], membrane[q]);
    if (neuron.membrane == Membrane::eq4)
        for (int q = 0; q < N; q++) membrane[q] = beta[q] * (membrane[q] + current_before[q]);
    else if (neuron.membrane == Membrane::delayed)
        for (int q = 0; q < N; q++) membrane[q] = beta[q] * membrane[q] + current_before[q];
    else
        for (int q = 0; q < N; q++) membrane[q] = beta[q] * membrane[q] + current[q];
    if (neuron.reset == Reset::zero)
        for (int q = 0; q < N; q++) membrane[q] = S::clear(fired[q], membrane[q]);
    else if (neuron.reset == Reset::subtract)
        for (int q = 0; q < N; q++) membrane[q] = membrane[q] - S::only(fired[q], threshold[q]);
}

// Where thresholds adapt, A[t+1] = decay A[t] + s[t]; `spiked` is s[t].
template <class S, int N, class T>
NT_INLINE void adaptation_step(const Adaptation<T>& how, Vectors<S, N>& adaptation, const typename S::Mask (&spiked)[N]) {
    for (int q = 0; q < N; q++)
        adaptation[q] = all<S>(how.decay) * adaptation[q] + S::only(spiked[q], typename S::V{} + 1);
}

// U - k A, which takes the place of U where it is compared with the threshold.
template <class S, int N, class T>
NT_INLINE Vectors<S, N> lowered(const Adaptation<T>& how, const Vectors<S, N>& membrane, const Vectors<S, N>& adaptation) {
    Vectors<S, N> to;
    for (int q = 0; q < N; q++) to[q] = membrane[q] - all<S>(how.strength) * adaptation[q];
    return to;
}

// theta = threshold + k A.
template <class S, int N, class T, class Values>
NT_INLINE Vectors<S, N> raised(const Adaptation<T>& how, const Values& threshold, const Vectors<S, N>& adaptation) {
    Vectors<S, N> to;
    for (int q = 0; q < N; q++) to[q] = threshold[q] + all<S>(how.strength) * adaptation[q];
    return to;
}

// The surrogate derivative 1 / (1 + scale |U - threshold|)^2 (texture paper, Eq. 7).
template <class S>
NT_INLINE typename S::V surrogate_slope(typename S::V membrane, typename S::V threshold, typename S::V scale) {
    const typename S::V wide = (typename S::V{} + 1) + scale * magnitude<S>(membrane - threshold);
    return (typename S::V{} + 1) / (wide * wide);
}

// What flows back through one step, for the vectors of a layer.
template <class S, int N>
struct Adjoint {
    Vectors<S, N> current{};   // dL/dI[t+1], as far as later steps made it
    Vectors<S, N> membrane{};  // dL/dU[t+1], likewise
};

// What one step gives to the gradients.
template <class S, int N>
struct StepGradient {
    Vectors<S, N> current;  // the complete dL/dI[t+1]
    Vectors<S, N> sum;      // dL/d(sum) of membrane_step, from which beta's gradient comes
};

// The same backwards. `adaptation` is dL/dA[t+2] and becomes dL/dA[t+1], `sloped` being slope(U - k A) dL/ds[t+1] with the
// share of dL/ds[t+1] that comes through A[t+2].
template <class S, int N, class T>
NT_INLINE void adaptation_back(const Adaptation<T>& how, Vectors<S, N>& adaptation, const Vectors<S, N>& sloped) {
    for (int q = 0; q < N; q++)
        adaptation[q] = all<S>(how.decay) * adaptation[q] - all<S>(how.strength) * sloped[q];
}

// Step t backwards. `sloped` is slope(U[t+1]) dL/ds[t+1], `fired` the reset of step t (U[t] > threshold). Leaves in
// `adjoint` the share of I[t] and U[t].
template <class S, int N, class Values>
NT_INLINE StepGradient<S, N> step_back(Neuron neuron, Adjoint<S, N>& adjoint, const Vectors<S, N>& sloped,
                                       const typename S::Mask (&fired)[N], const Values& alpha, const Values& beta) {
    StepGradient<S, N> to;
    for (int q = 0; q < N; q++) to.sum[q] = adjoint.membrane[q] + sloped[q];
    if (neuron.reset == Reset::zero)
        for (int q = 0; q < N; q++) to.sum[q] = S::clear(fired[q], to.sum[q]);
    to.current = adjoint.current;
    if (neuron.membrane == Membrane::immediate)
        for (int q = 0; q < N; q++) to.current[q] = to.current[q] + to.sum[q];
    for (int q = 0; q < N; q++) {
        adjoint.membrane[q] = beta[q] * to.sum[q];
        adjoint.current[q] = alpha[q] * to.current[q];
    }
    if (neuron.membrane == Membrane::eq4)
        for (int q = 0; q < N; q++) adjoint.current[q] = adjoint.current[q] + adjoint.membrane[q];
    else if (neuron.membrane == Membrane::delayed)
        for (int q = 0; q < N; q++) adjoint.current[q] = adjoint.current[q] + to.sum[q];
    if (neuron.reset == Reset::hard)
        for (int q = 0; q < N; q++) adjoint.membrane[q] = S::clear(fired[q], adjoint.membrane[q]);
    return to;
}

// Adds what one step gives to the gradients of alpha, beta and threshold, three rows of `pitch` neurons; `before` and
// `current_before` are U[t] and I[t].
template <class S, int N, class T>
NT_INLINE void add_dynamics(Neuron neuron, const StepGradient<S, N>& gradient, const Vectors<S, N>& sloped,
                            const Vectors<S, N>& before, const Vectors<S, N>& current_before,
                            const typename S::Mask (&fired)[N], T* sums, int64_t pitch) {
    for (int q = 0; q < N; q++) {
        T *alpha = sums + q * S::lanes, *beta = alpha + pitch, *threshold = beta + pitch;
        auto carried = neuron.reset == Reset::hard ? S::clear(fired[q], before[q]) : before[q];
        if (neuron.membrane == Membrane::eq4) carried = carried + current_before[q];
        store(alpha, load<S>(alpha) + gradient.current[q] * current_before[q]);
        store(beta, load<S>(beta) + gradient.sum[q] * carried);
        store(threshold, load<S>(threshold) - sloped[q]);
    }
}

}  // namespace neurotact::NT_ISA

// Afferents as Izhikevich neurons, from signals to spikes (encoders/izhikevich.py, izhikevich_step).
#include <algorithm>

#include "dispatch.hpp"
#include "strands.hpp"

namespace neurotact::NT_ISA {
namespace {

// Both populations under N vectors of taxels, those of a vector side by side: SA-I, RA-I. Returns the least current.
template <class T, int N>
T run(const Izhikevich<T>& e, const Strand* strands) {
    constexpr int L = kWide<T>;
    using S = Simd<T, L>;
    using V = typename S::V;
    using Bits = typename S::Bits;
    const int pitch = e.signals.pitch;
    const V gains[2] = {all<S>(e.sa_gain), all<S>(e.ra_gain)}, h = all<S>(e.step_ms), recovers = all<S>(e.recovers);
    const V b = all<S>(e.b), c = all<S>(e.c), peak = all<S>(e.peak);
    V least{}, last[N], v[2 * N], u[2 * N];
    const T* signal[N];
    for (int s = 0; s < N; s++) {
        signal[s] = e.signals.data + strands[s].in(e.signals.steps, pitch);
        last[s] = load<S>(e.has_last || !e.signals.steps ? e.last + strands[s].in(1, pitch) : signal[s]);
        for (int i = 0; i < 2; i++) {
            v[2 * s + i] = load<S>(e.membrane + strands[s].in(2, pitch) + i * pitch);
            u[2 * s + i] = load<S>(e.recovery + strands[s].in(2, pitch) + i * pitch);
        }
    }
    for (int64_t t = 0; t < e.signals.steps; t++) {
        V current[2 * N];
        Bits fired[2 * N] = {};
        for (int s = 0; s < N; s++) {
            const V now = load<S>(signal[s] + t * pitch);
            current[2 * s] = gains[0] * now;
            current[2 * s + 1] = gains[1] * magnitude<S>(now - last[s]);
            last[s] = now;
        }
        for (int i = 0; i < 2 * N; i++) least = current[i] < least ? current[i] : least;
        for (int step = 0; step < e.euler_steps; step++)
            for (int i = 0; i < 2 * N; i++) {
                const V slope = ((T)0.04 * v[i] + (T)5) * v[i] + (T)140 - u[i] + current[i];
                u[i] = u[i] + recovers * (b * v[i] - u[i]);
                v[i] = v[i] + h * slope;
                const Bits reset = v[i] >= peak;
                v[i] = reset ? c : v[i];
                u[i] = reset ? u[i] + e.d : u[i];
                fired[i] |= reset;
            }
        for (int s = 0; s < N; s++)
            for (int i = 0; i < 2; i++)
                store_bytes<L>(e.signals.spikes + strands[s].in(2 * e.signals.steps, pitch) + (2 * t + i) * pitch,
                               fired[2 * s + i]);
    }
    for (int s = 0; s < N; s++) {
        store(e.last + strands[s].in(1, pitch), last[s]);
        for (int i = 0; i < 2; i++) {
            store(e.membrane + strands[s].in(2, pitch) + i * pitch, v[2 * s + i]);
            store(e.recovery + strands[s].in(2, pitch) + i * pitch, u[2 * s + i]);
        }
    }
    T found = 0;
    for (int lane = 0; lane < L; lane++) found = std::min(found, (T)least[lane]);
    return found;
}

}  // namespace

template <class T>
T izhikevich(const Izhikevich<T>& e) {
    T least = 0;
    each_strand<2, kWide<T>>(e.signals, [&](const Strand* strands, auto N) {
        const T found = run<T, N.value>(e, strands);
#pragma omp critical
        least = std::min(least, found);
    });
    return least;
}

template NT_REAL izhikevich<NT_REAL>(const Izhikevich<NT_REAL>&);

}  // namespace neurotact::NT_ISA

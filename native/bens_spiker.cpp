// Ben's spiker algorithm, from signals to spikes (encoders/bens_spiker.py).
#include "dispatch.hpp"
#include "memory.hpp"
#include "strands.hpp"

namespace neurotact::NT_ISA {
namespace {

// ON and OFF under N vectors of taxels. The samples that are still ahead move through a buffer of `n_rows`, and back to
// its begin once they meet its end.
template <class T, int N>
void run(const BensSpiker<T>& e, const Strand* strands) {
    constexpr int L = kWide<T>, Q = 2 * N;
    using S = Simd<T, L>;
    using V = typename S::V;
    using Bits = typename S::Bits;
    const int pitch = e.signals.pitch, n_rows = 2 * e.n_taps;
    const V gain = all<S>(e.gain), threshold = all<S>(e.threshold);
    Block block((size_t)n_rows * Q * sizeof(V));
    V* const rows = reinterpret_cast<V*>(block.data());
    const auto kept = [&](int tap, int q) {
        return e.remaining + strands[q / 2].in(2 * e.n_taps, pitch) + (2 * tap + q % 2) * pitch;
    };
    for (int tap = 0; tap < e.n_taps; tap++)
        for (int q = 0; q < Q; q++) rows[tap * Q + q] = load<S>(kept(tap, q));
    V* window = rows;  // (tap, q)
    for (int64_t t = 0; t < e.signals.steps; t++) {
        window += Q;
        if (window + e.n_taps * Q > rows + n_rows * Q) {
            std::memmove(rows, window, (e.n_taps - 1) * Q * sizeof(V));
            window = rows;
        }
        for (int s = 0; s < N; s++) {
            const V now = load<S>(e.signals.data + strands[s].in(e.signals.steps, pitch) + t * pitch);
            V* newest = window + (e.n_taps - 1) * Q + 2 * s;
            newest[0] = gain * (now > 0 ? now : V{});
            newest[1] = gain * (-now > 0 ? -now : V{});
        }
        V with[Q] = {}, without[Q] = {};
        for (int tap = 0; tap < e.n_taps; tap++) {
            const V h = all<S>(e.taps[tap]);
            for (int q = 0; q < Q; q++) {
                with[q] += magnitude<S>(window[tap * Q + q] - h);
                without[q] += magnitude<S>(window[tap * Q + q]);
            }
        }
        for (int q = 0; q < Q; q++) {
            const V most = without[q] - threshold;
            const Bits fired = with[q] <= most;
            const int64_t row = strands[q / 2].in(2 * e.signals.steps, pitch) + (2 * t + q % 2) * pitch;
            store_bytes<L>(e.signals.spikes + row, fired);
            const auto quiet = S::greater(with[q], most);
            if (S::bits(quiet) == (uint32_t)((1ull << L) - 1)) continue;
            for (int tap = 0; tap < e.n_taps; tap++) window[tap * Q + q] -= S::clear(quiet, all<S>(e.taps[tap]));
        }
    }
    for (int tap = 0; tap < e.n_taps; tap++)
        for (int q = 0; q < Q; q++) store(kept(tap, q), window[tap * Q + q]);
}

}  // namespace

template <class T>
void bens_spiker(const BensSpiker<T>& e) {
    each_strand<2, kWide<T>>(e.signals, [&](const Strand* strands, auto N) { run<T, N.value>(e, strands); });
}

template void bens_spiker<NT_REAL>(const BensSpiker<NT_REAL>&);

}  // namespace neurotact::NT_ISA

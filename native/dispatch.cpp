#include "dispatch.hpp"

#include <cstdlib>
#include <cstring>
#include <stdexcept>

namespace neurotact {

Isa widest_isa() {
#if defined(NT_X86_KERNELS)
    __builtin_cpu_init();
    const bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq");
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") &&
                      __builtin_cpu_supports("popcnt");
    if (avx2 && avx512) return Isa::avx512;
    if (avx2) return Isa::avx2;
#endif
    return Isa::plain;
}

namespace {

Isa asked_for() {
    const char* name = std::getenv("NEUROTACT_ISA");
    const Isa widest = widest_isa();
    if (name == nullptr) return widest;
    Isa isa = widest;
    if (!std::strcmp(name, "plain")) isa = Isa::plain;
    if (!std::strcmp(name, "avx2")) isa = Isa::avx2;
    if (!std::strcmp(name, "avx512")) isa = Isa::avx512;
    return isa < widest ? isa : widest;
}

Isa& chosen() {
    static Isa isa = asked_for();
    return isa;
}

}  // namespace

Isa current_isa() { return chosen(); }

void set_isa(Isa isa) {
    if (isa > widest_isa()) throw std::invalid_argument("this processor does not have that instruction set");
    chosen() = isa;
}

template <class T>
const Kernels<T>& kernels() {
#define NT_TABLE(ISA)                                                                                     \
    {ISA::wide_forward<T>, ISA::wide_backward<T>, ISA::small_forward<T>, ISA::small_backward<T>,          \
     ISA::small_infer<T>, ISA::infer<T>, ISA::encode<T>, ISA::encode_exact<T>,                            \
     ISA::izhikevich<T>, ISA::bens_spiker<T>, ISA::mechanoreceptors<T>, ISA::tally<T>}
    if constexpr (sizeof(T) == sizeof(double)) {  // it checks gradients: one build does for every processor
        static const Kernels<T> table = NT_TABLE(plain);
        return table;
    } else {
#if defined(NT_X86_KERNELS)
        static const Kernels<T> tables[] = {NT_TABLE(plain), NT_TABLE(avx2), NT_TABLE(avx512)};
#else
        static const Kernels<T> tables[] = {NT_TABLE(plain)};
#endif
        return tables[static_cast<int>(chosen())];
    }
#undef NT_TABLE
}

const StreamKernels& stream_kernels() {
#if defined(NT_X86_KERNELS)
    static const StreamKernels* const tables[] = {&plain::stream_kernels, &avx2::stream_kernels, &avx512::stream_kernels};
#else
    static const StreamKernels* const tables[] = {&plain::stream_kernels};
#endif
    return *tables[static_cast<int>(chosen())];
}

template const Kernels<float>& kernels<float>();
template const Kernels<double>& kernels<double>();

// The register kernel takes a network whose layers fit; the figures that drew this line are in docs/kernels.md. In
// float64, which checks gradients, it is compiled for fewer widths.
Layout layout_of(const Sizes& n, const Neuron& neuron, bool is_double, bool adapts, bool wants_more) {
    const int most_hidden = is_double ? 32 : 64, most_classes = is_double ? 16 : n.hidden <= 32 ? 64 : 32;
    const bool is_compiled = !adapts || (!is_double && n.classes <= kAdaptingReadout);
    const bool small = !wants_more && is_compiled && n.hidden <= most_hidden && n.classes <= most_classes &&
                       !(neuron.emits_at_once() && neuron.recurrent_delay);
    const int of_small = n.classes <= 8 ? 8 : n.classes <= 16 ? 16 : n.classes <= 32 ? 32 : 64;
    const int readout = small && n.classes ? of_small : round_up(n.classes, kPitch);
    return {round_up(n.hidden, small && (adapts || n.classes > 16) ? kRarePitch : kPitch), readout, small};
}

}  // namespace neurotact

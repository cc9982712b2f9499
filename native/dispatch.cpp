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
    {ISA::wide_forward<T>, ISA::wide_backward<T>, ISA::small_forward<T>, ISA::small_backward<T>, ISA::infer<T>, \
     ISA::encode<T>}
#if defined(NT_X86_KERNELS)
    static const Kernels<T> tables[] = {NT_TABLE(plain), NT_TABLE(avx2), NT_TABLE(avx512)};
#else
    static const Kernels<T> tables[] = {NT_TABLE(plain)};
#endif
#undef NT_TABLE
    return tables[static_cast<int>(chosen())];
}

template const Kernels<float>& kernels<float>();
template const Kernels<double>& kernels<double>();

// The register kernel takes a fused network whose layers fit; the figures that drew this line are in docs/kernels.md.
// It is compiled with a recurrent delay for `delayed` alone, where published networks have one: it is most of the code.
Layout layout_of(const Sizes& n, Membrane membrane, int recurrent_delay, bool recurrent, bool learned_dynamics_or_inputs) {
    const bool compiled = recurrent && (recurrent_delay == 0 || membrane == Membrane::delayed);
    const bool small = compiled && !learned_dynamics_or_inputs && n.hidden <= 64 && n.classes >= 1 && n.classes <= 16;
    const int readout_pitch = small && n.classes <= 8 ? 8 : round_up(n.classes, 16);
    return {round_up(n.hidden, 16), readout_pitch, small};
}

}  // namespace neurotact

// One table of kernels per instruction set and float type; one of them is chosen when the module loads.
#pragma once

#include "kernels.hpp"

namespace neurotact {

// A stream lies in a block of `bytes`; `make` gives its handle there. `push` takes samples (sample, taxel) and writes
// decisions; `begin` forgets all but the number of windows.
struct StreamKernels {
    size_t (*bytes)(const StreamPlan&);
    void* (*make)(const StreamPlan&, char* block);
    int64_t (*push)(const StreamPlan&, void* stream, const float* samples, int64_t n, bool held, Decided* to);
    void (*begin)(const StreamPlan&, void* stream);
    void (*visit)(const StreamPlan&, void* stream, const Visitor&);
};

#define NT_DECLARE_KERNELS(ISA)                                                                      \
    namespace ISA {                                                                                  \
    template <class T>                                                                               \
    bool wide_forward(const Net<T>&, const Layout&, const Outputs<T>&, const Tape<T>*);              \
    template <class T>                                                                               \
    void wide_backward(const Net<T>&, const Layout&, const Tape<T>&, const Gradients<T>&);           \
    template <class T>                                                                               \
    bool small_forward(const Net<T>&, const Layout&, const Outputs<T>&, const Tape<T>*);             \
    template <class T>                                                                               \
    void small_backward(const Net<T>&, const Layout&, const Tape<T>&, const Gradients<T>&);          \
    template <class T>                                                                               \
    bool small_infer(const Net<T>&, const Layout&, const Decisions&);                                \
    template <class T>                                                                               \
    bool infer(const Net<T>&, const ExitRule&, const Decisions&);                     \
    template <class T>                                                                               \
    void encode(const Encoding<T>&);                                                                 \
    template <class T>                                                                               \
    void encode_exact(const ExactEncoding<T>&);                                                      \
    template <class T>                                                                               \
    T izhikevich(const Izhikevich<T>&);                                                              \
    template <class T>                                                                               \
    void bens_spiker(const BensSpiker<T>&);                                                          \
    template <class T>                                                                               \
    void mechanoreceptors(const Mechanoreceptors<T>&);                                               \
    template <class T>                                                                               \
    void tally(const TalliedPopulation<T>&);                                                         \
    extern const StreamKernels stream_kernels;                                                       \
    }
NT_DECLARE_KERNELS(avx512)
NT_DECLARE_KERNELS(avx2)
NT_DECLARE_KERNELS(plain)
#undef NT_DECLARE_KERNELS

// False from a forward pass or an inference: the input held a value that is neither 0 nor 1.
template <class T>
struct Kernels {
    bool (*wide_forward)(const Net<T>&, const Layout&, const Outputs<T>&, const Tape<T>*);
    void (*wide_backward)(const Net<T>&, const Layout&, const Tape<T>&, const Gradients<T>&);
    bool (*small_forward)(const Net<T>&, const Layout&, const Outputs<T>&, const Tape<T>*);
    void (*small_backward)(const Net<T>&, const Layout&, const Tape<T>&, const Gradients<T>&);
    bool (*small_infer)(const Net<T>&, const Layout&, const Decisions&);
    bool (*infer)(const Net<T>&, const ExitRule&, const Decisions&);
    void (*encode)(const Encoding<T>&);
    void (*encode_exact)(const ExactEncoding<T>&);
    T (*izhikevich)(const Izhikevich<T>&);  // the least current
    void (*bens_spiker)(const BensSpiker<T>&);
    void (*mechanoreceptors)(const Mechanoreceptors<T>&);
    void (*tally)(const TalliedPopulation<T>&);
};

enum class Isa : int { plain, avx2, avx512 };
Isa widest_isa();         // what the processor can
Isa current_isa();        // what is used: the widest, or what NEUROTACT_ISA or set_isa asked for
void set_isa(Isa isa);
template <class T>
const Kernels<T>& kernels();
const StreamKernels& stream_kernels();

}  // namespace neurotact

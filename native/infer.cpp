// Inference: hidden layer and readout step by step, nothing kept but the state, and out as soon as the rule says so.
#include "parallel.h"

#include "decide.hpp"
#include "dispatch.hpp"

namespace neurotact::NT_ISA {
namespace {

template <bool Adapts, class T, class Readout>
bool infer_trial(const Net<T>& net, const ForwardTables<T>& tables, InferState<T, Readout>& s, uint64_t* inputs,
                 int64_t trial, const ExitRule& rule, const Decisions& to) {
    const Sizes& n = net.sizes;
    bool binary = true;
    auto* counts = Readout::counts_of(to) + trial * n.classes;
    s.start(net, tables, counts);
    Leader<typename Readout::Value> leader{counts, n.classes};
    if (n.steps == 0) leader.index = leader.leading();
    int64_t steps = 0, input_spikes = 0, hidden_spikes = 0;
    while (steps < n.steps) {
        binary &= pack_step(net.spikes, trial, steps, n.inputs, inputs);
        const int n_rows = list_rows(inputs, words(n.inputs), 0, s.rows, 0);
        input_spikes += n_rows;
        hidden_spikes += s.template step<Adapts>(net, tables, n_rows, steps, leader);
        steps++;
        if (leader.exits(rule)) break;
    }
    to.labels[trial] = leader.index;
    to.steps[trial] = steps;
    to.input_spikes[trial] = input_spikes;
    to.hidden_spikes[trial] = hidden_spikes;
    return binary;
}

template <class T, class Readout>
bool infer_all(const Net<T>& net, const ExitRule& rule, const Decisions& to) {
    Carver measure, thread_measure;
    const ForwardTables<T> sizes(net, measure);
    InferState<T, Readout>(net, sizes, thread_measure);
    thread_measure.take<uint64_t>(words(net.sizes.inputs));
    Block block(measure.bytes() + net.threads * thread_measure.bytes());
    Carver carver(block.data());
    const ForwardTables<T> tables(net, carver);
    char* thread_memory = block.data() + measure.bytes();
    const auto run = net.adaptation.on ? infer_trial<true, T, Readout> : infer_trial<false, T, Readout>;
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        Carver mine(thread_memory + omp_get_thread_num() * thread_measure.bytes());
        InferState<T, Readout> state(net, tables, mine);
        uint64_t* inputs = mine.take<uint64_t>(words(net.sizes.inputs));
#pragma omp for schedule(dynamic, 4)
        for (int64_t trial = 0; trial < net.sizes.trials; trial++)
            others += !run(net, tables, state, inputs, trial, rule, to);
    }
    return others == 0;
}

}  // namespace

template <class T>
bool infer(const Net<T>& net, const ExitRule& rule, const Decisions& to) {
    return net.bias ? infer_all<T, IntegratingReadout<T>>(net, rule, to)
                    : infer_all<T, SpikingReadout<T>>(net, rule, to);
}

template bool infer<NT_REAL>(const Net<NT_REAL>&, const ExitRule&, const Decisions&);

}  // namespace neurotact::NT_ISA

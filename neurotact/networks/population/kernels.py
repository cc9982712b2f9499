"""The fused network, a hidden layer and a spiking readout, in Triton: many networks together, each with own weights.

A program runs `BT` windows of one network, forward or backward. States stay in registers for the whole window, spikes
are bits, and all programs of a network read the rows of the weights from the fast memory of its processor. The
equations are in `neurons.cuba_lif_step`, the adjoint is in `native/step.hpp`.

Forward adds in the order of the reference's `ordered` mode: decay, inputs ascending, hidden spikes ascending, each a
separate rounded addition. It must be compiled with `enable_fp_fusion=False`, so that none becomes a fused multiply-add.
Backward uses products of tiles; the compiler chooses their order.

Names: U and I are membrane and current of the hidden layer, Y and J those of the readout.
"""

# pyright: reportMissingImports=false
import triton
import triton.language as tl


@triton.jit
def _constant(constants, member, number: tl.constexpr):
    return tl.load(constants + member * 8 + number)


@triton.jit
def _dynamics(constants, member):
    """Decays of current and membrane, and thresholds; each of the hidden layer and of the readout."""
    alpha = _constant(constants, member, 0)
    alpha_out = _constant(constants, member, 1)
    beta = _constant(constants, member, 2)
    beta_out = _constant(constants, member, 3)
    threshold = _constant(constants, member, 4)
    threshold_out = _constant(constants, member, 5)
    return alpha, alpha_out, beta, beta_out, threshold, threshold_out


@triton.jit
def _work(windows, members, trials, most_trials, BT: tl.constexpr):
    """A program's place, tile, network, first slot, trials of the tile, number of real trials, and windows."""
    place = tl.program_id(0).to(tl.int64)
    tile = tl.program_id(1)
    member = tl.load(members + place).to(tl.int64)
    n_trials = tl.load(trials + place)
    trial = tile * BT + tl.arange(0, BT)
    slot = place * most_trials
    window = tl.load(windows + slot + trial, mask=trial < n_trials, other=0)
    return place, tile, member, slot, trial, n_trials, window


@triton.jit
def _membrane_step(membrane, current_before, current, beta, threshold, MEMBRANE: tl.constexpr, RESET: tl.constexpr):
    """U[t+1] from U[t], I[t] and I[t+1]."""
    keep = membrane <= threshold
    carried = membrane
    if RESET == "hard":
        carried = tl.where(keep, membrane, 0.0)
    if MEMBRANE == "eq4":
        following = beta * (carried + current_before)
    elif MEMBRANE == "delayed":
        following = beta * carried + current_before
    else:
        following = beta * carried + current
    if RESET == "zero":
        following = tl.where(keep, following, 0.0)
    elif RESET == "subtract":
        following = tl.where(keep, following, following - threshold)
    return following


@triton.jit
def _add_events(current, word, rows, n_rows, PITCH: tl.constexpr):
    """Add the weights of each row to the currents of the windows in which its bit is set, row after row."""
    lane = tl.arange(0, PITCH)
    for j in range(0, n_rows):
        is_set = ((word >> j) & 1) != 0
        current += tl.where(is_set[:, None], tl.load(rows + j * PITCH + lane)[None, :], 0.0)
    return current


@triton.jit
def _word(fired, lane, HP: tl.constexpr):
    """The spikes of a step as one word for each window."""
    if HP > 32:
        return tl.sum(fired.to(tl.int64) << lane[None, :].to(tl.int64), axis=1)
    else:
        return tl.sum(fired.to(tl.int32) << lane[None, :], axis=1)


@triton.jit
def _rows(trial, n_trials, wanted):
    """The rows of the real trials, if `wanted` holds for the whole program; else none."""
    return (trial < tl.where(wanted, n_trials, 0))[:, None]


@triton.jit
def forward(
    spikes, windows, members, sizes, trials, constants, weights,
    hidden_tape, readout_tape, hidden_counts, readout_counts,
    most_trials, n_steps, n_inputs,
    IP: tl.constexpr, HP: tl.constexpr, OP: tl.constexpr, BT: tl.constexpr, WORDS: tl.constexpr,
    MEMBRANE: tl.constexpr, RESET: tl.constexpr, DELAYED: tl.constexpr, RECURRENT: tl.constexpr, KEEP: tl.constexpr,
):  # fmt: skip
    """Run windows of a batch of each network; see `population.Population` for the arrays."""
    _, tile, member, slot, trial, n_trials, window = _work(windows, members, trials, most_trials, BT)
    n_hidden = tl.load(sizes + member)
    real = trial < n_trials
    lane = tl.arange(0, HP)
    out_lane = tl.arange(0, OP)
    # Offsets within a place fit in 32 bits: the host ensures it.
    kept = trial[:, None] * (n_steps * HP) + lane[None, :]
    kept_out = trial[:, None] * (n_steps * OP) + out_lane[None, :]
    hidden_tape += slot * n_steps * HP
    readout_tape += slot * n_steps * OP
    w_in = weights + member * (IP * HP + HP * HP + HP * OP)
    w_rec = w_in + IP * HP
    w_out = w_rec + HP * HP
    alpha, alpha_out, beta, beta_out, threshold, threshold_out = _dynamics(constants, member)

    current = tl.zeros([BT, HP], tl.float32)
    membrane = tl.zeros([BT, HP], tl.float32)
    count = tl.zeros([BT, HP], tl.float32)
    current_out = tl.zeros([BT, OP], tl.float32)
    membrane_out = tl.zeros([BT, OP], tl.float32)
    count_out = tl.zeros([BT, OP], tl.float32)
    word = _word(membrane > threshold, lane, HP)
    word_before = word
    # A tile without windows runs no steps.
    steps = tl.where(tile * BT < n_trials, n_steps, 0)
    for t in range(0, steps):
        before = current
        current = alpha * current
        for k in range(0, WORDS):
            arriving = tl.load(spikes + t * WORDS + k + window * (n_steps * WORDS), mask=real, other=0)
            current = _add_events(current, arriving, w_in + 32 * k * HP, tl.minimum(n_inputs - 32 * k, 32), HP)
        if RECURRENT:
            current = _add_events(current, word_before if DELAYED else word, w_rec, n_hidden, HP)
        fired_before = membrane > threshold
        membrane = _membrane_step(membrane, before, current, beta, threshold, MEMBRANE, RESET)
        fired = membrane > threshold
        word_before = word
        word = _word(fired, lane, HP)
        if MEMBRANE == "immediate":
            sent = word
            count += fired.to(tl.float32)
        else:
            sent = word_before
            count += fired_before.to(tl.float32)

        before_out = current_out
        current_out = _add_events(alpha_out * current_out, sent, w_out, n_hidden, OP)
        decided_before = membrane_out > threshold_out
        membrane_out = _membrane_step(membrane_out, before_out, current_out, beta_out, threshold_out, MEMBRANE, RESET)
        if MEMBRANE == "immediate":
            count_out += (membrane_out > threshold_out).to(tl.float32)
        else:
            count_out += decided_before.to(tl.float32)
        if KEEP:
            tl.store(hidden_tape + t * HP + kept, membrane, mask=real[:, None])
            tl.store(readout_tape + t * OP + kept_out, membrane_out, mask=real[:, None])
    counted = trial[:, None] * HP + lane[None, :]
    decided = trial[:, None] * OP + out_lane[None, :]
    tl.store(hidden_counts + slot * HP + counted, count, mask=real[:, None])
    tl.store(readout_counts + slot * OP + decided, count_out, mask=real[:, None])


@triton.jit
def _layer_back(
    after, before, g_spike, g_current, g_membrane, alpha, beta, threshold, scale,
    MEMBRANE: tl.constexpr, RESET: tl.constexpr,
):  # fmt: skip
    """A backward step of a layer: the complete dL/dI[t+1], and the parts of dL/dI[t] and dL/dU[t].

    after, before: U[t+1] and U[t]; g_spike: dL/ds[t+1].
    """
    wide = 1.0 + scale * tl.abs(after - threshold)
    keep = before <= threshold
    g_sum = g_membrane + g_spike / (wide * wide)
    if RESET == "zero":
        g_sum = tl.where(keep, g_sum, 0.0)
    complete = g_current
    if MEMBRANE == "immediate":
        complete += g_sum
    g_membrane = beta * g_sum
    g_current = alpha * complete
    if MEMBRANE == "eq4":
        g_current += g_membrane
    elif MEMBRANE == "delayed":
        g_current += g_sum
    if RESET == "hard":
        g_membrane = tl.where(keep, g_membrane, 0.0)
    return complete, g_current, g_membrane


@triton.jit
def backward(
    spikes, windows, members, trials, constants, weights,
    hidden_tape, readout_tape, g_hidden, g_readout, gradients,
    most_trials, n_steps, n_inputs, n_tiles,
    IP: tl.constexpr, HP: tl.constexpr, OP: tl.constexpr, BT: tl.constexpr, WORDS: tl.constexpr,
    MEMBRANE: tl.constexpr, RESET: tl.constexpr, DELAYED: tl.constexpr, RECURRENT: tl.constexpr,
):  # fmt: skip
    """The gradients of the weights of each network, summed over the windows of a tile.

    g_hidden, g_readout: dL/d counts; gradients: `(place, tile, weight)`.
    """
    place, tile, member, slot, trial, n_trials, window = _work(windows, members, trials, most_trials, BT)
    real = trial < n_trials
    lane = tl.arange(0, HP)
    out_lane = tl.arange(0, OP)
    kept = trial[:, None] * (n_steps * HP) + lane[None, :]
    kept_out = trial[:, None] * (n_steps * OP) + out_lane[None, :]
    hidden_tape += slot * n_steps * HP
    readout_tape += slot * n_steps * OP
    in_lane = tl.arange(0, IP)
    is_input = (in_lane < n_inputs)[:, None] & real[None, :]
    arrives = window[None, :] * (n_steps * WORDS) + (in_lane // 32)[:, None]
    n_weights: tl.constexpr = IP * HP + HP * HP + HP * OP
    w_rec = weights + member * n_weights + IP * HP
    w_out = w_rec + HP * HP
    rec_transposed = tl.trans(tl.load(w_rec + lane[:, None] * HP + lane[None, :]))
    out_transposed = tl.trans(tl.load(w_out + lane[:, None] * OP + out_lane[None, :]))
    alpha, alpha_out, beta, beta_out, threshold, threshold_out = _dynamics(constants, member)
    scale = _constant(constants, member, 6)
    scale_out = _constant(constants, member, 7)
    counted = tl.load(g_hidden + slot * HP + trial[:, None] * HP + lane[None, :], mask=real[:, None], other=0.0)
    decided = tl.load(g_readout + slot * OP + trial[:, None] * OP + out_lane[None, :], mask=real[:, None], other=0.0)

    g_in = tl.zeros([IP, HP], tl.float32)
    g_rec = tl.zeros([HP, HP], tl.float32)
    g_out = tl.zeros([HP, OP], tl.float32)
    g_current = tl.zeros([BT, HP], tl.float32)
    g_membrane = tl.zeros([BT, HP], tl.float32)
    g_current_out = tl.zeros([BT, OP], tl.float32)
    g_membrane_out = tl.zeros([BT, OP], tl.float32)
    g_spike = tl.zeros([BT, HP], tl.float32)  # dL/ds[t+1], unless `immediate`
    returned = tl.zeros([BT, HP], tl.float32)  # V dL/dI of the step after, and of the one after that
    returned_later = returned
    steps = tl.where(tile * BT < n_trials, n_steps, 0)
    last = n_steps - 1
    after = tl.load(hidden_tape + last * HP + kept, mask=real[:, None], other=0.0)
    after_out = tl.load(readout_tape + last * OP + kept_out, mask=real[:, None], other=0.0)
    # Before the first step, neurons are at rest.
    before = tl.load(hidden_tape + (last - 1) * HP + kept, mask=_rows(trial, n_trials, n_steps > 1), other=0.0)
    for back in range(0, steps):
        t = steps - 1 - back
        later = _rows(trial, n_trials, t > 0)
        before_out = tl.load(readout_tape + (t - 1) * OP + kept_out, mask=later, other=0.0)
        later_still = _rows(trial, n_trials, t > 1)
        earlier = tl.load(hidden_tape + (t - 2) * HP + kept, mask=later_still, other=0.0)
        if MEMBRANE == "immediate":
            g_decided = decided
            sent = after > threshold
        else:
            g_decided = tl.where(back > 0, decided, 0.0)  # s[T] is never sent
            sent = before > threshold
        complete_out, g_current_out, g_membrane_out = _layer_back(
            after_out, before_out, g_decided, g_current_out, g_membrane_out,
            alpha_out, beta_out, threshold_out, scale_out, MEMBRANE, RESET,
        )  # fmt: skip
        g_out += tl.dot(tl.trans(sent.to(tl.float32)), complete_out, input_precision="ieee")
        g_sent = counted + tl.dot(complete_out, out_transposed, input_precision="ieee")
        if MEMBRANE == "immediate":
            g_spike = g_sent + (returned_later if DELAYED else returned)
        complete, g_current, g_membrane = _layer_back(
            after, before, g_spike, g_current, g_membrane, alpha, beta, threshold, scale, MEMBRANE, RESET
        )
        words = tl.load(spikes + t * WORDS + arrives, mask=is_input, other=0)
        arrived = ((words >> (in_lane % 32)[:, None]) & 1).to(tl.float32)
        g_in += tl.dot(arrived, complete, input_precision="ieee")
        returned_later = returned
        if RECURRENT:
            returning = (earlier if DELAYED else before) > threshold
            g_rec += tl.dot(tl.trans(returning.to(tl.float32)), complete, input_precision="ieee")
            returned = tl.dot(complete, rec_transposed, input_precision="ieee")
        if MEMBRANE != "immediate":
            g_spike = g_sent + (returned_later if DELAYED else returned)
        after = before
        before = earlier
        after_out = before_out
    to = gradients + (place * n_tiles + tile) * n_weights
    tl.store(to + in_lane[:, None] * HP + lane[None, :], g_in)
    tl.store(to + IP * HP + lane[:, None] * HP + lane[None, :], g_rec)
    tl.store(to + IP * HP + HP * HP + lane[:, None] * OP + out_lane[None, :], g_out)

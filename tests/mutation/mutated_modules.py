"""The modules that `make mutation` tries, the tests of each, and the mutants that change nothing, with the reason."""

# tests that run in seconds and that have to notice a change of the module; the quickest come first
MODULES: dict[str, tuple[str, ...]] = {
    "telenano/afm/safety.py": (
        "tests/unit/afm/test_safety_codes.py",
        "tests/unit/afm/test_afm_safety.py",
        "tests/unit/afm/test_afm_way.py",
    ),
    "telenano/extend/feedback.py": (
        "tests/unit/afm/test_integral_share.py",
        "tests/unit/afm/test_feedback.py",
    ),
    "telenano/afm/programs/runner.py": ("tests/unit/afm/test_program_runner.py",),
    "telenano/hand/safety.py": (
        "tests/unit/hand/test_haptic_safety.py",
        "tests/unit/afm/test_safety_codes.py",
    ),
    "telenano/timing/freshness.py": (
        "tests/unit/timing/test_freshness_of_inputs.py",
        "tests/unit/timing/test_runtime_freshness.py",
    ),
    "telenano/runtime/loop/deferred.py": ("tests/unit/runtime/test_deferred_tasks.py",),
    "telenano/wire/node_state.py": ("tests/unit/wire/test_runtime_node_state.py",),
    "telenano/runtime/loop/journal.py": (
        "tests/unit/runtime/test_journal_state.py",
        "tests/unit/runtime/test_runtime_node.py",
    ),
    "telenano/runtime/loop/node_loop.py": (
        "tests/unit/runtime/test_loop_edges.py",
        "tests/unit/runtime/test_loop_admission.py",
        "tests/unit/runtime/test_runtime_node.py",
    ),
    "telenano/runtime/loop/commands.py": ("tests/unit/runtime/test_runtime_commands.py",),
    "telenano/runtime/security/zap_authenticator.py": (
        "tests/unit/runtime/test_zap_enforcement.py",
        "tests/unit/runtime/test_runtime_transport.py",
    ),
    "telenano/link/direction.py": (
        "tests/unit/link/test_link_order.py",
        "tests/unit/link/test_link_outages.py",
        "tests/unit/link/test_link_state.py",
    ),
    "telenano/runtime/loop/estop_latch.py": ("tests/unit/runtime/test_runtime_estop_latch.py",),
    "telenano/console/emergency_stop.py": (
        "tests/unit/console/test_ways_of_stops.py",
        "tests/unit/console/test_emergency_stop.py",
    ),
    "telenano/laws/energy.py": ("tests/unit/laws/test_energy.py",),
    "telenano/extend/virtual_mass.py": (
        "tests/unit/laws/test_virtual_mass.py",
        "tests/unit/laws/test_passivity_ports.py",
    ),
    "telenano/laws/hand_periods.py": ("tests/unit/laws/test_hand_periods.py",),
    "telenano/laws/integration.py": ("tests/unit/laws/test_integration.py",),
    "telenano/laws/passivity.py": (
        "tests/unit/laws/test_passivity_ports.py",
        "tests/unit/laws/test_passivity.py",
    ),
    "telenano/recording/verify.py": (
        "tests/unit/recording/test_verify_missing.py",
        "tests/unit/recording/test_odd_times.py",
    ),
    "telenano/analysis/motion_fit.py": (
        "tests/unit/analysis/test_verdict_parts.py",
        "tests/unit/analysis/test_verdict_pulses.py",
        "tests/unit/analysis/test_verdict_noise.py",
        "tests/unit/analysis/test_verdict.py",
        "tests/verdicts/test_kept_verdicts.py",
        "tests/verdicts/test_judge.py",
    ),
    "telenano/analysis/envelope.py": (
        "tests/unit/analysis/test_verdict_parts.py",
        "tests/unit/analysis/test_verdict_noise.py",
        "tests/unit/analysis/test_verdict.py",
        "tests/verdicts/test_kept_verdicts.py",
        "tests/verdicts/test_judge.py",
    ),
    "telenano/analysis/measured_noise.py": ("tests/unit/analysis/test_beyond_noise.py",),
    "telenano/analysis/beyond_noise.py": (
        "tests/unit/analysis/test_beyond_noise.py",
        "tests/unit/analysis/test_verdict.py",
        "tests/verdicts/test_kinds.py",
    ),
    "telenano/analysis/verdict.py": (
        "tests/unit/analysis/test_verdict.py",
        "tests/verdicts/test_kept_verdicts.py",
    ),
    "telenano/analysis/verdict_sentences.py": ("tests/unit/analysis/test_verdict_sentences.py",),
    "telenano/analysis/decision.py": (
        "tests/unit/analysis/test_verdict_parts.py",
        "tests/unit/analysis/test_verdict_noise.py",
        "tests/unit/analysis/test_verdict.py",
        "tests/verdicts/test_kept_verdicts.py",
        "tests/verdicts/test_judge.py",
    ),
    "telenano/analysis/read_out.py": ("tests/unit/analysis/test_read_out.py",),
    "telenano/analysis/holds.py": (
        "tests/unit/analysis/test_hand_cycles.py",
        "tests/unit/analysis/test_holds.py",
        "tests/unit/analysis/test_verdict_noise.py",
    ),
    "telenano/analysis/interruptions.py": ("tests/unit/analysis/test_interruptions.py",),
    "telenano/analysis/phases.py": ("tests/unit/analysis/test_phases.py",),
    "telenano/analysis/conditions.py": ("tests/unit/analysis/test_conditions.py",),
    "telenano/afm/standalone_guard.py": ("tests/unit/afm/test_standalone_guard.py",),
    "telenano/runtime/loop/hang_guard.py": ("tests/unit/runtime/test_hang_guard.py",),
    "telenano/runtime/loop/device_node.py": ("tests/unit/runtime/test_runtime_device_node.py",),
}

# by module, the name of a mutant as a run prints it, and why no test can tell it from the original
EQUIVALENT: dict[str, dict[str, str]] = {
    "telenano/afm/safety.py": {
        "_way: if offset < goal: [offset < goal => offset <= goal]": "an offset at its goal stays there in both",
    },
    "telenano/analysis/phases.py": {
        "contacts_of: for first, end in edges.reshape(-1, 2): [1 => 2]": "any number below nought means that this"
        " length follows from the other",
        "phases_of: begins_s = float(hand_time_s[moving[0]]) if moving.size and greatest > 0.0 else end_s"
        " [greatest > 0.0 => greatest >= 0.0]": "no force is greater than a share of one that is nought",
    },
    "telenano/extend/feedback.py": {
        "carried_out: if proportional_m > 0.0: [proportional_m > 0.0 => proportional_m >= 0.0]": "of no proportional"
        " part nothing is taken on either way",
    },
    "telenano/afm/programs/runner.py": {
        "ProgramRunner.restore: if plan is not None and reached is not None:"
        " [plan is not None and reached is not None => plan is not None or reached is not None]": "a state has both of"
        " them or neither",
    },
    "telenano/runtime/loop/journal.py": {
        "InputJournal.__init__: self._next_state_ns = 0 [0 => 1]": "no turn is taken a nanosecond after 1970",
    },
    "telenano/runtime/loop/node_loop.py": {
        "NodeLoop.turn_now: if self._deferred.due_ns < NEVER_NS:"
        " [self._deferred.due_ns < NEVER_NS => self._deferred.due_ns <= NEVER_NS]": "no task is due then",
        "install_stop_signals: signal.set_wakeup_fd(writer.detach(), warn_on_full_buffer=False) [False => True]": "only"
        " a process that gets more signals than the socket holds is warned of it",
    },
    "telenano/wire/node_state.py": {
        "_names: if not _open_fields(kind): [not _open_fields(kind) => False]": "the same names, looked up field by"
        " field",
    },
    "telenano/timing/freshness.py": {
        "Freshness.age_s: is_newest = hand_t_ns >= self._newest_from_ns [hand_t_ns >= self._newest_from_ns => hand_t_ns"
        " > self._newest_from_ns]": "the lag of the newest sample is kept only to save looking it up",
        "DelayHistory.forget_before: if place > 0: [place > 0 => place >= 0]": "deletes the first 0 entries",
        "Freshness.age_s: return sample_age_s if sample_age_s > message_age_s else message_age_s"
        " [sample_age_s > message_age_s => sample_age_s >= message_age_s]": "where both are equal either is the same",
        "Freshness.__init__: self._judged_ns = 0 [0 => 1]": "no sample of a hand is a nanosecond after 1970",
        "Freshness.age_s: taken_ns = hand_t_ns + (self._newest_lag_ns if is_newest else self.lag_ns(hand_t_ns))"
        " [self._newest_lag_ns if is_newest else self.lag_ns(hand_t_ns) => self.lag_ns(hand_t_ns)]": "the lag of the"
        " newest sample is kept only to save looking it up",
    },
    "telenano/runtime/loop/deferred.py": {
        "DeferredTasks.__init__: self._begin(Gap(-NEVER_NS, 0, NEVER_NS), in_gap=False) [False => True]": "a gap"
        " before the first event would have begun"
        " endlessly long ago, and is not measured",
        "DeferredTasks.__init__: self._begin(Gap(-NEVER_NS, 0, NEVER_NS), in_gap=False) [0 => 1]": "no gap has begun,"
        " so nothing fits"
        " in, however long it is",
    },
    "telenano/runtime/loop/commands.py": {
        **{
            f"CommandHandler.__init__: self._stalled_s = 0.0 {change}": "read only after it was set"
            for change in ("[self._stalled_s = 0.0 => pass]", "[0.0 => 1.0]")
        },
        "CommandClient.__init__: self._sender = token(8) [8 => 9]": "another number of random bytes tells"
        " senders apart as well",
        'stop_of: src, number = f"estop@{site_of(node)}", token(12) [12 => 13]': "another number of random"
        " bytes tells stops apart as well",
        "CommandClient._issue: self._issued += 1 [1 => 2]": "only that the ids of commands differ counts",
        "CommandHandler.__init__: self._distrust_until_ns = 0 [0 => 1]": "no command comes a nanosecond after 1970",
    },
    "telenano/runtime/loop/estop_latch.py": {
        "EstopLatch.__init__: self._run = token(6) [6 => 7]": "a name with one character more serves as well",
        "EstopLatch.__init__: self._newest_ns = 0 [0 => 1]": "an age is stated in tenths of a second",
    },
    "telenano/console/emergency_stop.py": {
        "_send: reader.set(zmq.LINGER, 0) [reader.set(zmq.LINGER, 0) => pass]": "libzmq itself waits for"
        " nothing at the end of a socket that subscribes",
        "_send: while time.monotonic() < next_s and reader.poll(0): [0 => 1]": "a turn waits for one more"
        " answer by a millisecond at most",
        "_send: while time.monotonic() < next_s and reader.poll(0): [time.monotonic() < next_s =>"
        " time.monotonic() <= next_s]": "at that very nanosecond one answer more is read before the next turn",
        "module: _MOST_SUBSCRIPTIONS = 256 [256 => 512]": "any number at which a turn ends that is above what one inlet"
        " is sent in it",
    },
    "telenano/runtime/security/zap_authenticator.py": {
        "BoundEndpoint: attempts: int = 0 [0 => 1]": "set to 0 where an endpoint is unbound, before any is counted",
        "ZapAuthenticator.prepare: socket.set(zmq.ZAP_ENFORCE_DOMAIN, 1) [1 => 2]": "libzmq takes any number but 0",
    },
    "telenano/link/direction.py": {
        "DirectionEngine.restore: pipeline = self._pipeline = Pipeline(self._direction, settings, files, 0)"
        " [0 => 1]": "every time in the pipeline is restored a few lines later",
        "DirectionEngine._schedule: self._pushed += 1 [1 => 2]": "only the order of these numbers counts",
        **{
            f"DirectionEngine._delay: if delay_ns == 0 and not (heap and heap[0][0] <= now_ns): {change}": "a message"
            " without a delay goes out by way of the heap then, in the same call"
            for change in ("[0 => 1] (3)", "[delay_ns == 0 and (not (heap and heap[0][0] <= now_ns)) => False]")
        },
    },
    "telenano/extend/virtual_mass.py": {
        "bounded: return -most if value < -most else value [value < -most => value <= -most]": "at the bound value and"
        " bound are the same number",
    },
    "telenano/laws/hand_periods.py": {
        "module: RESTARTED = -1 [1 => 2]": "any negative number is not a count",
        "no_sample: return HandClock(-1, 0) [0 => 1]": "the first sample sets the place of the grid",
        "no_sample: return HandClock(-1, 0) [1 => 2]": "any negative time stamp stands for none",
        "periods_to: periods = 1 if since_ns == period_ns else max(0, (since_ns + period_ns // 2) // period_ns)"
        " [1 if since_ns == period_ns else max(0, (since_ns + period_ns // 2) // period_ns) =>"
        " max(0, (since_ns + period_ns // 2) // period_ns)]": "the same number, with a division in the common case too",
        "periods_to: periods = 1 if since_ns == period_ns else max(0, (since_ns + period_ns // 2) // period_ns)"
        " [max(0, (since_ns + period_ns // 2) // period_ns) => (since_ns + period_ns // 2) // period_ns]": "the grid is"
        " at most half a period later than the sample before, and this one is later than that",
    },
    "telenano/laws/integration.py": {
        "module: _NEVER_NS = -1 [1 => 2]": "any negative time stands for none",
        "_passes_over: return params.local_ns > 0 and outstanding and now_ns < timing.commands.lasts_ns -"
        " params.period_ns // 2 [0 => 1]": "no half with a loop of its own has a last signal that counts for a"
        " nanosecond",
        "slave_measured: if held or number <= c.carried_out or not 0 < later < _LAST:"
        " [0 < later < _LAST => 0 <= later < _LAST]": "a state with the newest command has returned before",
        "module: _ENDLESS = 2**40 [2 => 3]": "any number of periods above the longest step",
        "module: _ENDLESS = 2**40 [40 => 41]": "any number of periods above the longest step",
        **{
            f"slave_begin: commands = Commands(-1, -1, (0, 0, 0, 0, 0, 0, 0, 0), False, True, 0) {change}": reason
            for reason, changes in {
                "any negative number stands for no command": ("[1 => 2]",),
                "the first command sets it": ("[-1 => 1] (2)", "[1 => 2] (2)", "[True => False]"),
                "no more steps are added up than commands were sent, and each of these brings its own": (
                    "[0 => 1]",
                    *(f"[0 => 1] ({place})" for place in range(2, 9)),
                ),
                "before the first step it is compared with the present time alone": ("[0 => 1] (9)",),
            }.items()
            for change in changes
        },
        **{
            f"slave_begin: return SlaveTiming(no_sample(), nothing_heard(), Pacing(1, 0, 1), commands) {change}": "the"
            " first signal begins anew, and sets it"
            for change in ("[1 => 2]", "[0 => 1]", "[1 => 2] (2)")
        },
    },
    "telenano/laws/passivity.py": {
        **{
            name: "how long a device stood counts only for a mass that is coupled, whose half sets it to nought at each"
            " sample of a hand that follows"
            for name in (
                "master_start: return MasterState(at_rest(hand.position_m), opened(params.start_j), 0.0, port)"
                " [0.0 => 1.0]",
                "master_resume: return MasterState(mass, opened(params.start_j), 0.0, port) [0.0 => 1.0]",
            )
        },
        **{
            f"paid_motion: {change}": "`back` is 1 or -1"
            for change in (
                "if own_m * back > paid: [own_m * back => own_m / back]",
                "return back * min(own_m * back, motion_m * back), 0.0 [own_m * back => own_m / back]",
                "return back * min(own_m * back, motion_m * back), 0.0 [motion_m * back => motion_m / back]",
            )
        },
        "slave_receive: account = shared_out(charged(account, work, refused if motion != wanted else 0.0),"
        " params.shared) [refused if motion != wanted else 0.0 => refused]": "of a motion"
        " that was not cut nothing is refused, but for rounding",
        "slave_retune: if rise > 0.0: [rise > 0.0 => rise >= 0.0]": "where nothing rises nothing is paid or granted",
        "taken: if energy_j > 0.0: [energy_j > 0.0 => energy_j >= 0.0]": "the store keeps what it has either way where"
        " nothing is taken",
        "moved_by_what_is_paid: damper = params.refill_n_s_per_m * min(max(1.0 - account.remaining_j / params.level_j,"
        " 0.0), 1.0) [1.0 => 2.0] (2)": "a motion of the hand is cut to what its store has, which is never below zero",
    },
    "telenano/recording/verify.py": {
        "_Check.run: log_ns >= last_ns [log_ns >= last_ns => log_ns > last_ns]": "one received at the same time is"
        " looked at more closely, with the same outcome",
        '_Check._check_schema: pairs = zip(("seq", "t_ns", "src"), header, stated, strict=True)'
        " [True => False]": "there are three of each",
    },
    "telenano/analysis/motion_fit.py": {
        "Window.cycles: return mode.frequency_hz * self.length_s * (min(seen / change, 1.0) if change > seen else 1.0)"
        " [change > seen => change >= seen]": "where both are equal their ratio is 1",
    },
    "telenano/analysis/verdict.py": {
        "judge: if noise > ERROR_SHARE * max(hand_force_n, float(np.ptp(values))): [noise > ERROR_SHARE *"
        " max(hand_force_n, float(np.ptp(values))) => noise >= ERROR_SHARE * max(hand_force_n,"
        " float(np.ptp(values)))]": "only noise of this size to its last bit is taken otherwise: the force of the hand"
        " is not nought",
    },
    "telenano/analysis/envelope.py": {
        "has_line: if count < 2.0: [count < 2.0 => count <= 2.0]": "an octave has 2, 4, 8 or more lines, of"
        " which three are never left beside one and its neighbours",
    },
    "telenano/analysis/read_out.py": {
        "line_n: angle = 2.0 * math.pi * turns * np.arange(len(left)) / max(1, len(left) - 1) [1 => 2]": "no line is"
        " looked for in two samples",
    },
    "telenano/analysis/conditions.py": {
        **{
            'title: least_ms, greatest_ms = conditions.get("link_round_trip_range_ms") or (0.0, 0.0) [0.0 => 1.0]'
            + which: "a range of a millisecond or less is no wider than one of nothing"
            for which in ("", " (2)")
        },
    },
    "telenano/analysis/holds.py": {
        "judge_holds: is_held = len(pressed) and abs(float(pressed.mean()) - force) < ERROR_SHARE * greatest"
        " [abs(float(pressed.mean()) - force) < ERROR_SHARE * greatest => abs(float(pressed.mean()) - force) <="
        " ERROR_SHARE * greatest]": "only a mean of samples that is off by this to its last bit is taken otherwise",
        "_without_hand: gain = float(np.cumsum(bare * moved)[-1]) / max(float(np.cumsum(bare * bare)[-1]), 1e-300)"
        " [1e-300 => 2e-300]": "any number above nought keeps a hand that does not tremble from being divided by",
        **{
            "_rest_facts: last = session.at(0.5 * ((hold.rest_from_s or 0.0) + (hold.judged_to_s or 0.0)),"
            f" hold.judged_to_s or 0.0) {change}": "where a tip rests both are known, and a rest from the"
            " beginning of a session is compared half a second later"
            for change in ("[0.0 => 1.0]", "[0.0 => 1.0] (3)")
        },
        "_judge_swing: last_s = max(swing.start_s, swing.end_s - 1.0 / swing.frequency_hz) [max(swing.start_s,"
        " swing.end_s - 1.0 / swing.frequency_hz) => swing.end_s - 1.0 / swing.frequency_hz]": "it has three turns",
        "_judge_swing: dies_out = left_n < 0.5 * swing.peak_to_peak_n [left_n < 0.5 * swing.peak_to_peak_n =>"
        " left_n <= 0.5 * swing.peak_to_peak_n]": "only a swing that is halved to its last bit is taken otherwise",
    },
}

"""The modules that `make mutation` tries, the tests of each, and the mutants that change nothing, with the reason."""

# tests that run in seconds and that have to notice a change of the module; the quickest come first
MODULES: dict[str, tuple[str, ...]] = {
    "services/afm_node/safety.py": (
        "tests/unit/afm_node/test_safety_codes.py",
        "tests/unit/afm_node/test_afm_safety.py",
    ),
    "services/afm_node/programs/feedback.py": (
        "tests/unit/afm_node/test_integral_share.py",
        "tests/unit/afm_node/test_feedback.py",
    ),
    "services/haptic_node/safety.py": (
        "tests/unit/haptic_node/test_haptic_guard_edges.py",
        "tests/unit/haptic_node/test_haptic_safety.py",
        "tests/unit/afm_node/test_safety_codes.py",
    ),
    "services/runtime/loop/freshness.py": (
        "tests/unit/runtime/test_freshness_of_inputs.py",
        "tests/unit/runtime/test_hand_age_histories.py",
        "tests/unit/runtime/test_runtime_freshness.py",
    ),
    "services/runtime/loop/deferred.py": ("tests/unit/runtime/test_deferred_tasks.py",),
    "services/runtime/loop/node.py": (
        "tests/unit/runtime/test_loop_edges.py",
        "tests/unit/runtime/test_loop_admission.py",
        "tests/unit/runtime/test_runtime_node.py",
    ),
    "services/runtime/loop/commands.py": (
        "tests/unit/runtime/test_command_edges.py",
        "tests/unit/runtime/test_runtime_commands.py",
    ),
    "services/runtime/security/zap_authenticator.py": (
        "tests/unit/runtime/test_zap_enforcement.py",
        "tests/unit/runtime/test_runtime_transport.py",
    ),
    "services/delay_node/engine.py": (
        "tests/unit/delay_node/test_link_order.py",
        "tests/unit/delay_node/test_link_state.py",
    ),
    "services/controller/laws/passivity.py": (
        "tests/unit/controller/test_passivity_ports.py",
        "tests/unit/controller/test_passivity.py",
    ),
    "services/recorder/listener.py": (
        "tests/unit/recorder/test_listener_changes.py",
        "tests/unit/recorder/test_recorder_batches.py",
    ),
    "recording/verify.py": ("tests/unit/recording/test_verify_missing.py",),
}

# by module, the name of a mutant as a run prints it, and why no test can tell it from the original
EQUIVALENT: dict[str, dict[str, str]] = {
    "services/runtime/loop/freshness.py": {
        "DelayHistory.forget_before: if place > 0: [place > 0 => place >= 0]": "deletes the first 0 entries",
        "Freshness.__init__: self._judged_ns = 0 [0 => 1]": "no sample of a hand is a nanosecond after 1970",
        "Freshness.age_s: taken_ns = hand_t_ns + (self._newest_lag_ns if is_newest else self.lag_ns(hand_t_ns))"
        " [self._newest_lag_ns if is_newest else self.lag_ns(hand_t_ns) => self.lag_ns(hand_t_ns)]": "the lag of the"
        " newest sample is kept only to save looking it up",
    },
    "services/runtime/loop/commands.py": {
        "CommandHandler.__init__: self._stalled_s = 0.0 [self._stalled_s = 0.0 => pass]": "read only after it was set",
        "CommandHandler.__init__: self._distrust_until_ns = 0 [0 => 1]": "no command comes a nanosecond after 1970",
    },
    "services/runtime/security/zap_authenticator.py": {
        "ZapAuthenticator.prepare: socket.set(zmq.ZAP_ENFORCE_DOMAIN, 1) [1 => 2]": "libzmq takes any number but 0",
    },
    "services/delay_node/engine.py": {
        "DirectionEngine.restore: pipeline = self._pipeline = Pipeline(self._direction, settings, files, 0)"
        " [0 => 1]": "every time in the pipeline is restored a few lines later",
    },
    "services/recorder/listener.py": {
        "Listener: _last_batch_ns: int = 0 [0 => 1]": "read only after the first batch, which sets it",
    },
    "recording/verify.py": {
        "_Check.__init__: self._last_ns = 0 [0 => 1]": "no message was received a nanosecond after 1970",
        "_Check.run: first, last, log_ns = self._open_gaps.get((channel.channel_topic, channel.src), (0, 0, 0))"
        " [0 => 1] (3)": "this time belongs to a gap that begins at number 0, and a newest number of -1 does not exist",
    },
}

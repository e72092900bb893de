"""Environments for reinforcement learning; importing this package registers them with Gymnasium.

import gymnasium
import telenano_lab.learning

env = gymnasium.make("telenano/Push-v0")
"""

from gymnasium.envs import registration

PUSH = "telenano/Push-v0"

if PUSH not in registration.registry:
    registration.register(
        PUSH,
        entry_point="telenano_lab.learning.push_env:PushEnv",
        vector_entry_point="telenano_lab.learning.push_env:PushVectorEnv",
    )

"""The environments to learn in: to import this registers them with Gymnasium.

import gymnasium
import telenano.learn

env = gymnasium.make("telenano/Push-v0")
"""

from studies.learning.registration import register as register

register()

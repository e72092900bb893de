"""The names of the environments."""

from proto.extras import missing

PUSH = "telenano/Push-v0"


def register() -> None:
    """Register the environments with Gymnasium, once.

    Raises:
        ModuleNotFoundError: Gymnasium is missing; the message says what to install.
    """
    try:
        from gymnasium.envs import registration
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{PUSH}: {missing('gymnasium')}", name=error.name) from error
    if PUSH not in registration.registry:
        registration.register(
            PUSH,
            entry_point="studies.learning.push_env:PushEnv",
            vector_entry_point="studies.learning.push_env:PushVectorEnv",
        )

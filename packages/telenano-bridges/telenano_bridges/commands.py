"""The commands of this distribution, which telenano lists without importing their modules."""

COMMANDS = {
    "bridge foxglove": ("telenano_bridges.foxglove:foxglove", "Serve every topic to Foxglove and Lichtblick."),
    "bridge lsl": ("telenano_bridges.lsl:lsl", "Publish states, events and trials on the Lab Streaming Layer."),
    "bridge ros2": ("telenano_bridges.ros2:ros2", "Publish positions and forces in ROS 2 by the names of CRTK."),
}

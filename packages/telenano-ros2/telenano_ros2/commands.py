"""The commands of this package, which telenano lists without importing what they need."""

COMMANDS = {
    "bridge ros2": ("telenano_ros2.command:ros2", "Publish positions and forces in ROS 2 by the names of CRTK."),
}

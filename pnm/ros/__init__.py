"""The ROS 2 side; nothing else in the project imports `rclpy`.

Every call of `rclpy` is made on one thread (`pnm.ros.node.ros_thread.RosThread`); what it learns crosses to
asyncio by ``loop.call_soon_threadsafe``. All of these modules can be imported without ROS 2; making
a `RosThread` then says what to install.
"""

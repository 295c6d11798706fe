# SPDX-License-Identifier: Apache-2.0
"""Results for stations that speak no ROS: to an MQTT broker, and in an OPC UA server."""

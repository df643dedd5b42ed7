"""Link, controller and actuator run with their own measured inputs: what is left of output and measurement."""

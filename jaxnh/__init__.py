"""jaxnh: complete identification of chaos in nonlinear nonholonomic systems, on JAX and diffrax."""

__version__ = "0.1.0"

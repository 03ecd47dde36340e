"""Independent programs for the thesis models: numpy and scipy only, nothing of rotorsim.

Every model is written out from S. Singh (IIT Guwahati, 2015); equation numbers are the thesis' own.
The time solutions are right-hand sides for `scipy.integrate.solve_ivp`; the linear models have, in
addition, an exact solution: harmonics from the frequency domain and the transient from the matrix
exponential. Signs: x + iy is positive from x to y, the direction of rotation.
"""

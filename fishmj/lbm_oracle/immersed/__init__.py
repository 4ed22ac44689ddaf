"""The fish in the fluid: markers, the immersed boundary, the water inside the hull, and the coupled solve with its links.

`coupling.FluidStructure.step` is the method; it solves   (M + dt D + K) v+ = (M + dt D) v + dt f - b0 + I.

Interior water. The immersed boundary also accelerates the lattice's water inside the hull, which a real hull does not contain.
The links therefore get back the momentum that this water gains:

    I = sum_l J_l^T (h_l^n - h_l^n-1 - dt m_l g),      h_l = (m_l (u_l + t_l (s_l - t_l . u_l)), I_l w_l)

m_l: displaced mass of link l, I_l its moment of inertia, u_l and w_l its velocities, t_l its axis.

    kernels.py:measure, mean        s_l: speed of the water along each link; across the link it moves with the link
    link_dynamics.py:move           h_l from pose, velocity and s_l
    link_dynamics.py:add_interior   I, called by `assemble`, which writes the right-hand side
    coupling.py:take_wrench         the same gain, added to the force that the markers exchanged
    device_steps.py:push_link       h_l and its share of I, if the body moves on the device too

Without I a fish is heavier by the water it displaces: virtual mass 1.89 instead of 0.89 m_f of a sphere, and momentum drifts.
"""

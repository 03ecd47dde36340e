/* The plants and their loops, written by hand from the physics: dx = f(x, u), y: what is recorded. at(m, PLACE, v) is
   where an effect may act; the order of places is that of plants.py. Parameters p in the order of plants.py. */

/* A1 h1' = k u - c1 sqrt h1,  A2 h2' = c1 sqrt h1 - c2 sqrt h2      levels [m], pump voltage [V]; Torricelli */
static void two_tanks(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { DRIVE, INFLOW, HEAD1, OUTFLOW1, NET1, HEAD2, OUTFLOW2, NET2, READ1, READ2 };
  const double k = m->p[0], c1 = m->p[1], c2 = m->p[2], iA1 = m->p[3], iA2 = m->p[4];
  y[0] = at(m, READ1, x[0]);
  y[1] = at(m, READ2, x[1]);
  const double in = at(m, INFLOW, k * at(m, DRIVE, u[0]));
  const double out1 = at(m, OUTFLOW1, c1 * sqrt(fmax(at(m, HEAD1, x[0]), 0.0)));
  const double out2 = at(m, OUTFLOW2, c2 * sqrt(fmax(at(m, HEAD2, x[1]), 0.0)));
  dx[0] = iA1 * at(m, NET1, in - out1);
  dx[1] = iA2 * at(m, NET2, out1 - out2);
}

/* C1 T1' = P - G (T1 - T2),  C2 T2' = G (T1 - T2) - L (T2 - T0),  P = KP e + KI int e dt,  e = r - T2   [K, W] */
static void heated_chamber(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { SENSED1, SENSED2, ERROR, INTEGRAND, INTEGRAL, POWER, HEATER, HEAT, CHAMBER, NET, LOSS };
  const double iC1 = m->p[0], G = m->p[1], iC2 = m->p[2], L = m->p[3], KP = m->p[4], KI = m->p[5];
  const double T1 = at(m, HEATER, x[0]), T2 = at(m, CHAMBER, x[1]);
  y[1] = at(m, SENSED1, T1);
  y[2] = at(m, SENSED2, T2);
  const double e = at(m, ERROR, u[0] - y[2]), q = at(m, INTEGRAL, x[2]);
  y[0] = KP * e + q;
  dx[2] = at(m, INTEGRAND, KI * e);
  const double heat = at(m, HEAT, G * (T1 - T2)), loss = at(m, LOSS, L * (T2 - u[1]));
  dx[0] = iC1 * (at(m, POWER, y[0]) - heat);
  dx[1] = iC2 * at(m, NET, heat - loss);
}

/* L i' = d Vs - R i - v,  C v' = i - G v,  d = KP e + KI int e dt,  e = r - v     state-space averaging */
static void buck_converter(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { CURRENT, VOLTAGE, SENSED_I, SENSED_V, INTEGRAL, INTEGRAND, DUTY, SWITCHED, DROP, NET_V, LOAD, NET_I };
  const double iL = m->p[0], R = m->p[1], iC = m->p[2], G = m->p[3], KP = m->p[4], KI = m->p[5];
  const double i = at(m, CURRENT, x[0]), v = at(m, VOLTAGE, x[1]);
  y[1] = at(m, SENSED_I, i);
  y[2] = at(m, SENSED_V, v);
  const double e = u[0] - y[2], q = at(m, INTEGRAL, x[2]);
  y[0] = KP * e + q;
  dx[2] = at(m, INTEGRAND, KI * e);
  const double on = at(m, SWITCHED, at(m, DUTY, y[0]) * u[1]);
  dx[0] = iL * at(m, NET_V, on - at(m, DROP, R * i) - v);
  dx[1] = iC * at(m, NET_I, i - at(m, LOAD, G * v));
}

/* tau s' = c - s,  p' = H (Kq s - Kc p - A v),  M v' = A p - b v,  z' = v,  c = KP (r - z)    Merritt (1967), ch. 6 */
static void hydraulic_cylinder(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { PRESSURE, SPEED, POSITION, SENSED_P, SENSED_Z, COMMAND, SPOOL, FLOW, LEAKAGE, NET_Q, PUSH, DRAG, NET_F };
  const double Kq = m->p[0], H = m->p[1], Kc = m->p[2], iM = m->p[3], b = m->p[4];
  const double A = m->p[5], KP = m->p[6], tau = m->p[7];
  const double p = at(m, PRESSURE, x[1]), v = at(m, SPEED, x[2]), z = at(m, POSITION, x[3]);
  y[1] = at(m, SENSED_P, p);
  y[2] = at(m, SENSED_Z, z);
  y[0] = KP * (u[0] - y[2]);
  dx[0] = (at(m, COMMAND, y[0]) - x[0]) / tau;
  const double in = at(m, FLOW, Kq * at(m, SPOOL, x[0]));
  dx[1] = H * at(m, NET_Q, in - at(m, LEAKAGE, Kc * p) - A * v);
  dx[2] = iM * at(m, NET_F, at(m, PUSH, A * p) - at(m, DRAG, b * v));
  dx[3] = v;
}

/* M x'' = F - b x' + W a,  a'' = -(x'' + g a)/l - d a',  F = KP (r - x) - KD x'     a: angle of the rope, small */
static void crane(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { SPEED, TROLLEY, RATE, SWING, SENSED_X, SENSED_A, ERROR, FEEDBACK, FORCE, DRAG, PULL, NET, NET_SWING };
  const double iM = m->p[0], b = m->p[1], W = m->p[2], il = m->p[3], d = m->p[4];
  const double KP = m->p[5], KD = m->p[6], g = m->p[7];
  const double v = at(m, SPEED, x[0]), s = at(m, TROLLEY, x[1]), w = at(m, RATE, x[2]), a = at(m, SWING, x[3]);
  y[1] = at(m, SENSED_X, s);
  y[2] = at(m, SENSED_A, a);
  y[0] = KP * at(m, ERROR, u[0] - y[1]) - at(m, FEEDBACK, KD * v);
  const double F = at(m, FORCE, y[0]), drag = at(m, DRAG, b * v), pull = at(m, PULL, W * a);
  dx[0] = iM * at(m, NET, F - drag + pull);
  dx[1] = v;
  dx[2] = at(m, NET_SWING, -il * (dx[0] + g * a) - d * w);
  dx[3] = w;
}

/* M1 v1' = F - b1 v1 - B,  M2 v2' = B - b2 v2,  B = K s + c s',  s' = v1 - v2 */
static void belt_drive(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { SPEED1, SPEED2, SENSED1, SENSED2, FORCE, DRAG1, STRETCH, SPRING, DAMPING, BELT, DRAG2, NET1, NET2 };
  const double iM1 = m->p[0], K = m->p[1], c = m->p[2], iM2 = m->p[3], b2 = m->p[4], b1 = m->p[5];
  const double v1 = at(m, SPEED1, x[0]), v2 = at(m, SPEED2, x[1]);
  y[0] = at(m, SENSED1, v1);
  y[1] = at(m, SENSED2, v2);
  const double spring = at(m, SPRING, K * at(m, STRETCH, x[2]));
  const double B = at(m, BELT, spring + at(m, DAMPING, c * (v1 - v2)));
  dx[0] = iM1 * at(m, NET1, at(m, FORCE, u[0]) - at(m, DRAG1, b1 * v1) - B);
  dx[1] = iM2 * at(m, NET2, B - at(m, DRAG2, b2 * v2));
  dx[2] = v1 - v2;
}

/* Lf i' = U - Rf i,  La j' = K i w - Ra j - RL j,  v = RL j,  U = KP e + KI int e dt,  e = r - v    w: speed [rad/s] */
static void generator(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { FIELD, ARMATURE, SENSED_I, SENSED_V, ERROR, INTEGRAL, INTEGRAND, EXCITER, DROP, NET_FIELD, FLUX, EMF, NET_ARM };
  const double iLf = m->p[0], Rf = m->p[1], K = m->p[2], iLa = m->p[3];
  const double RL = m->p[4], Ra = m->p[5], KP = m->p[6], KI = m->p[7];
  const double i = at(m, FIELD, x[0]), j = at(m, ARMATURE, x[1]), v = RL * j;
  y[1] = at(m, SENSED_I, i);
  y[2] = at(m, SENSED_V, v);
  const double e = at(m, ERROR, u[0] - y[2]), q = at(m, INTEGRAL, x[2]);
  y[0] = KP * e + q;
  dx[2] = at(m, INTEGRAND, KI * e);
  dx[0] = iLf * at(m, NET_FIELD, at(m, EXCITER, y[0]) - at(m, DROP, Rf * i));
  const double emf = at(m, EMF, at(m, FLUX, K * i) * u[1]);
  dx[1] = iLa * at(m, NET_ARM, emf - Ra * j - v);
}

/* tau a' = c - a,  z'' = K sin a - b z',  c = KP (r - z) - KD s z / (1 + T s)     a: slope [rad] */
static void ball_and_beam(machine *m, const double *u, const double *x, double *dx, double *y) {
  enum { ANGLE, SPEED, BALL, SENSED_A, CAMERA, ERROR, COMMAND, SLOPE, PULL, DRAG, NET };
  const double tau = m->p[0], K = m->p[1], b = m->p[2], KP = m->p[3], KD = m->p[4], T = m->p[5];
  const double a = at(m, ANGLE, x[0]), v = at(m, SPEED, x[1]), z = at(m, BALL, x[2]);
  y[1] = at(m, SENSED_A, a);
  y[2] = at(m, CAMERA, z);
  const double rate = (y[2] - x[3]) / T;
  dx[3] = rate;
  y[0] = KP * at(m, ERROR, u[0] - y[2]) - KD * rate;
  dx[0] = (at(m, COMMAND, y[0]) - x[0]) / tau;
  const double pull = at(m, PULL, K * sin(at(m, SLOPE, a)));
  dx[1] = at(m, NET, pull - at(m, DRAG, b * v));
  dx[2] = v;
}

typedef void plant(machine *, const double *, const double *, double *, double *);
static plant *const plants[] = {two_tanks, heated_chamber, buck_converter, hydraulic_cylinder,
                                crane,     belt_drive,     generator,      ball_and_beam};

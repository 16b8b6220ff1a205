/*
$about
 */
#include <math.h>

#include "$file.h"

#define N $links

static const int PRISMATIC[N] = {$prismatic};
static const int PARENT[N] = {$parents};
static const int FOLLOWS[N] = {$follows};
static const double RATIO[N] = {$ratios};
static const double OFFSET[N] = {$offsets};
static const double GRAVITY[3] = {$gravity};
static const double BEFORE[N][3][4] = $before;
static const double AFTER[N][3][4] = $after;
/* m [kg], m c (3) [kg m], J (xx xy xz yy yz zz) about the frame's origin [kg m^2] */
static const double LINK[N][10] = {
$parameters
};

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* out += a x b */
static void add_cross(const double a[3], const double b[3], double out[3])
{
    double c[3];
    int k;
    cross(a, b, c);
    for (k = 0; k < 3; k++) out[k] += c[k];
}

/* out = R v, with the rotation in the first three columns of a pose */
static void turn(const double R[3][4], const double v[3], double out[3])
{
    int k;
    for (k = 0; k < 3; k++) out[k] = R[k][0] * v[0] + R[k][1] * v[1] + R[k][2] * v[2];
}

/* out = R' v */
static void turn_back(const double R[3][4], const double v[3], double out[3])
{
    int k;
    for (k = 0; k < 3; k++) out[k] = R[0][k] * v[0] + R[1][k] * v[1] + R[2][k] * v[2];
}

/* v turned about z by the angle whose cosine and sine are c and s */
static void turn_z(double c, double s, double v[3])
{
    const double x = v[0], y = v[1];
    v[0] = c * x - s * y;
    v[1] = s * x + c * y;
}

/* a += wd x r + w x (w x r): acceleration of the point r of a body */
static void to_point(const double w[3], const double wd[3], const double r[3], double a[3])
{
    double v[3];
    add_cross(wd, r, a);
    cross(w, r, v);
    add_cross(w, v, a);
}

void ${name}_rigid(const double q[$n], const double dq[$n], const double ddq[$n], double tau[$n])
{
    double w[N][3], wd[N][3], a[N][3];  /* angular velocity, angular and linear acceleration of the
                                           link frames, in their own axes; gravity is in a */
    double force[N][3], moment[N][3];   /* that each link needs for what it carries */
    int i, j, k;

    /* From the base to the tips: motion. */
    for (i = 0; i < $n; i++) tau[i] = 0.0;
    for (i = 0; i < N; i++) {
        const double x = RATIO[i] * q[FOLLOWS[i]] + OFFSET[i];
        const double dx = RATIO[i] * dq[FOLLOWS[i]], ddx = RATIO[i] * ddq[FOLLOWS[i]];
        const double c = PRISMATIC[i] ? 1.0 : cos(x), s = PRISMATIC[i] ? 0.0 : sin(x);
        const double before[3] = {BEFORE[i][0][3], BEFORE[i][1][3], BEFORE[i][2][3]};
        const double after[3] = {AFTER[i][0][3], AFTER[i][1][3], AFTER[i][2][3]};
        double w0[3], wd0[3], a0[3], wj[3], wdj[3], aj[3];

        j = PARENT[i];
        for (k = 0; k < 3; k++) {
            force[i][k] = moment[i][k] = 0.0;
            w0[k] = j < 0 ? 0.0 : w[j][k];
            wd0[k] = j < 0 ? 0.0 : wd[j][k];
            a0[k] = j < 0 ? -GRAVITY[k] : a[j][k];
        }
        to_point(w0, wd0, before, a0);
        turn_back(BEFORE[i], w0, wj);
        turn_back(BEFORE[i], wd0, wdj);
        turn_back(BEFORE[i], a0, aj);
        if (PRISMATIC[i]) {
            const double slide[3] = {0.0, 0.0, x};
            to_point(wj, wdj, slide, aj);
            aj[0] += 2.0 * wj[1] * dx;
            aj[1] -= 2.0 * wj[0] * dx;
            aj[2] += ddx;
        } else {
            turn_z(c, -s, wj);
            turn_z(c, -s, wdj);
            turn_z(c, -s, aj);
            wdj[0] += wj[1] * dx;
            wdj[1] -= wj[0] * dx;
            wdj[2] += ddx;
            wj[2] += dx;
        }
        to_point(wj, wdj, after, aj);
        turn_back(AFTER[i], wj, w[i]);
        turn_back(AFTER[i], wdj, wd[i]);
        turn_back(AFTER[i], aj, a[i]);
    }

    /* From the tips to the base: forces, and moments about the frames' origins. */
    for (i = N - 1; i >= 0; i--) {
        const double *p = LINK[i], *h = &LINK[i][1];
        const double x = RATIO[i] * q[FOLLOWS[i]] + OFFSET[i];
        const double c = PRISMATIC[i] ? 1.0 : cos(x), s = PRISMATIC[i] ? 0.0 : sin(x);
        const double before[3] = {BEFORE[i][0][3], BEFORE[i][1][3], BEFORE[i][2][3]};
        const double after[3] = {AFTER[i][0][3], AFTER[i][1][3], AFTER[i][2][3]};
        const double J[3][4] = {{p[4], p[5], p[6], 0.0},
                                {p[5], p[7], p[8], 0.0},
                                {p[6], p[8], p[9], 0.0}};
        double f[3], m[3], v[3], given[3];

        /* f = m a + wd x h + w x (w x h),  m = J wd + w x (J w) + h x a */
        for (k = 0; k < 3; k++) f[k] = p[0] * a[i][k];
        to_point(w[i], wd[i], h, f);
        turn(J, wd[i], m);
        turn(J, w[i], v);
        add_cross(w[i], v, m);
        add_cross(h, a[i], m);
        for (k = 0; k < 3; k++) {
            force[i][k] += f[k];
            moment[i][k] += m[k];
        }
        /* to the moved joint frame, where the torque is the z component */
        turn(AFTER[i], force[i], f);
        turn(AFTER[i], moment[i], m);
        add_cross(after, f, m);
        tau[FOLLOWS[i]] += RATIO[i] * (PRISMATIC[i] ? f[2] : m[2]);
        /* to the frame of the link that carries this one */
        j = PARENT[i];
        if (j < 0) continue;
        if (PRISMATIC[i]) {
            m[0] -= x * f[1];
            m[1] += x * f[0];
        } else {
            turn_z(c, s, f);
            turn_z(c, s, m);
        }
        turn(BEFORE[i], f, given);
        turn(BEFORE[i], m, v);
        add_cross(before, given, v);
        for (k = 0; k < 3; k++) {
            force[j][k] += given[k];
            moment[j][k] += v[k];
        }
    }
}

$sign$signature
{
$torque}

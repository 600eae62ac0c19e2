# Coefficients of Tsit5 (Tsitouras 2011, Computers & Mathematics with Applications
# 62, 770–775), which the gradient needs; the tests compare them with the solver.

"""
Stage positions c of Tsit5. The seventh stage is the first one of the next step.
"""
const TSIT5_C = (0.0, 0.161, 0.327, 0.9, 0.9800255409045097, 1.0, 1.0)

"""
Stage weights of Tsit5, 7 × 7. Column i contains the weights of the slopes 1 … i − 1 in the
state at which slope i is evaluated; column 7 gives the state after the step.
"""
const TSIT5_A = let a = zeros(7, 7)
    a[1, 2] = 0.161
    a[1:2, 3] .= (-0.008480655492356989, 0.335480655492357)
    a[1:3, 4] .= (2.8971530571054935, -6.359448489975075, 4.3622954328695815)
    a[1:4, 5] .= (
        5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525,
    )
    a[1:5, 6] .= (
        5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
        -0.028269050394068383,
    )
    a[1:6, 7] .= (
        0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742,
        -3.290069515436081, 2.324710524099774,
    )
    a
end

# Column i: coefficients of θ, θ², θ³, θ⁴ in the weight of slope i.
const TSIT5_INTERPOLANT = [
    1.0 0.0 0.0 0.0 0.0 0.0 0.0
    -2.763706197274826 0.13169999999999998 3.9302962368947516 -12.411077166933676 37.50931341651104 -27.896526289197286 1.5
    2.9132554618219126 -0.2234 -5.941033872131505 30.33818863028232 -88.1789048947664 65.09189467479366 -4.0
    -1.0530884977290216 0.1017 2.490627285651253 -16.548102889244902 47.37952196281928 -34.87065786149661 2.5
]

"""
    interpolation_weight(i, θ)

Weight of slope i in Tsit5's interpolant of order four, at the fraction θ of the step.
"""
function interpolation_weight(i::Integer, θ::Float64)
    c = TSIT5_INTERPOLANT
    return @inbounds θ * (c[1, i] + θ * (c[2, i] + θ * (c[3, i] + θ * c[4, i])))
end

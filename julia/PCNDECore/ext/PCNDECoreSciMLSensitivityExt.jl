module PCNDECoreSciMLSensitivityExt

using PCNDECore: PCNDECore, ReferenceFlow, reference_loss
using SciMLSensitivity: InterpolatingAdjoint, ZygoteVJP
using Zygote: Zygote

function PCNDECore.adjoint_gradient(
    problem::ReferenceFlow,
    parameters::Vector{Float64};
    sensealg = InterpolatingAdjoint(autojacvec = ZygoteVJP()),
)
    return only(Zygote.gradient(θ -> reference_loss(problem, θ; sensealg), parameters))
end

end

import torch


def integrated_time(x, bounds):
    """stub"""
    longest = max(b.stop - b.start for b in bounds)
    size = 2 ** (2 * longest - 1).bit_length()
    total = x.new_zeros(x.shape[0], longest)
    for b in bounds:
        f = torch.fft.rfft(x[:, b], n=size)
        total += torch.fft.irfft(f.abs().square(), n=size)[:, :longest]
    rho = total / total[:, :1].clamp(min=1e-300)
    tau = 2 * torch.cumsum(rho, 1) - 1
    lags = torch.arange(longest, dtype=x.dtype)
    inside = lags >= 5 * tau
    first = torch.where(inside.any(1), inside.to(torch.int8).argmax(1), longest - 1)
    return tau.gather(1, first.unsqueeze(1))[:, 0].clamp(min=1.0)

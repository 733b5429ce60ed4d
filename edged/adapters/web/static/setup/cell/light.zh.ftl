# Texts of light.js.
light-title = 光照和对焦
light-what = 使边缘清晰且没有过曝：先调光照，再调镜头环，同时观察对精度的影响。
light-thing = 请先在工件所在位置放一块标定板或一个工件：光照和对焦据此判断，空场景会给出错误建议。
light-thing-is = 已放好
light-thing-there = 光照和对焦按那里的物体判断。
light-thing-gone = 那里已没有物体
light-take = 设置曝光时间和增益需要相机：请先接管单元。
light-no-settings = 此处无可设置：相机未报告限值，或不存在。
light-no-figures = 数值随实时图像显示。
settings-left = 左相机设置
settings-right = 右相机设置
setting-exposure-us = 曝光时间
setting-gain-db = 增益
light-head = 光照
light-figures = { $clipped } % 过曝，{ $dark } % 过暗，噪声 { $noise }、对比度 { $contrast } 灰度级
advice-good = 曝光合适。
advice-less-light = 有过曝部分，无法测量：请缩短曝光或减弱光照。
advice-more-light = 太暗：请延长曝光或增强光照。
advice-light-for-gain = 噪声大：请降低增益，改用更长曝光或更强光照。
advice-take = 设为 { $exposure } µs
legend-clipped = 过曝
legend-dark = 过暗
light-copy = 右相机使用相同设置
focus-title = 对焦
focus-none = 没有可判断的边缘：请放一块标定板或一个工件。
focus-now = 边缘宽度 { $now } px
focus-best = 最佳 { $best } px
focus-cost =
    { $isFree ->
        [0] 对 Z 的 σ 没有影响。
       *[other] 使 Z 的 σ 增大 { $percent } %。
    }
focus-reset = 清除最佳值
